// Moves the figure of web_page.py: states of a motion, or modes with an amplitude.
(async () => {
  const spec = JSON.parse(document.getElementById("spec").textContent);
  const byId = (id) => document.getElementById(id);
  const plot = byId("plot");
  const d = spec.dimension;
  const names = spec.figure.data.map((trace) => trace.name);
  const driven = names[0]; // "strings" where none is passive
  const colorable = [driven, "passive strings", "bars", "driven bars"].filter((name) => names.includes(name));
  const bars = ["bars", "driven bars"].filter((name) => names.includes(name));

  function unpacked(text) {
    if (text === null) return null;
    const characters = atob(text);
    const bytes = new Uint8Array(characters.length);
    for (let i = 0; i < bytes.length; i++) bytes[i] = characters.charCodeAt(i);
    return new Float32Array(bytes.buffer);
  }
  const nodes = unpacked(spec.nodes);
  const gamma = unpacked(spec.gamma);
  const share = unpacked(spec.share);
  const real = unpacked(spec.real);
  const imaginary = unpacked(spec.imaginary);
  const size = d * spec.index.nodes.length;
  const frames = nodes.length / size;
  const strings = gamma === null ? 0 : gamma.length / frames;

  // ---- what is shown ----

  // Place in the motion, s, or in the swing of a mode, turns.
  const now = { clock: 0, frame: 0, playing: false, turning: false };

  function swung() {
    const mode = Number(byId("mode").value);
    const most = Number(byId("amplitude").value) * spec.size;
    const [c, s] = [Math.cos(2 * Math.PI * now.clock), Math.sin(2 * Math.PI * now.clock)];
    return nodes.map((x, i) => x + most * (real[mode * size + i] * c - imaginary[mode * size + i] * s));
  }

  function positions() {
    return real === null ? nodes.subarray(now.frame * size, (now.frame + 1) * size) : swung();
  }

  function gathered(at, index) {
    const part = { x: [], y: [], z: [] };
    ["x", "y", "z"].forEach((axis, k) => {
      part[axis] = Float32Array.from(index, (node) => (node < 0 ? NaN : k < d ? at[d * node + k] : 0));
    });
    return part;
  }

  function tensions(at, own) {
    const length = new Float32Array(strings);
    spec.segments.forEach(([start, end], i) => {
      let squares = 0;
      for (let k = 0; k < d; k++) squares += (at[d * end + k] - at[d * start + k]) ** 2;
      length[spec.segmentString[i]] += Math.sqrt(squares);
    });
    return own.map((value, i) => value * length[i]);
  }

  // Force over strength, of strings, then of bars.
  const byShare = () => share !== null && byId("color").value === spec.shareName;
  const members = share === null ? 0 : share.length / frames;
  const shares = () => share.subarray(now.frame * members, (now.frame + 1) * members);

  // Three points a segment: start, end, and the break after them.
  const stringOf = (point) => spec.segmentString[Math.floor(point / 3)];

  function update() {
    const at = positions();
    const change = {};
    let color = {};
    let index = spec.index.strings;
    if (gamma !== null) {
      const own = gamma.subarray(now.frame * strings, (now.frame + 1) * strings);
      const slack = index.map((node, i) => own[stringOf(i)] <= spec.slack);
      change["slack strings"] = gathered(at, index.map((node, i) => (slack[i] ? node : -1)));
      index = index.map((node, i) => (slack[i] ? -1 : node));
      const chosen = byId("color").value;
      if (chosen) {
        const values = byShare() ? shares() : chosen.startsWith("tension") ? tensions(at, own) : own;
        color = { color: Float32Array.from(index, (node, i) => values[stringOf(i)]) };
      }
    }
    if (spec.passive !== null) {
      const springs = index.map((node, i) => (spec.passive[stringOf(i)] ? node : -1));
      change["passive strings"] = { ...gathered(at, springs), ...color };
      index = index.map((node, i) => (spec.passive[stringOf(i)] ? -1 : node));
    }
    change[driven] = { ...gathered(at, index), ...color };
    for (const name of [...bars, "nodes", "supports"]) change[name] = gathered(at, spec.index[name]);
    if (byShare()) {
      const values = shares().subarray(strings);
      const color = Float32Array.from(spec.index.bars, (node, i) => values[Math.floor(i / 3)]);
      for (const name of bars) change[name].color = color;
    }
    if (spec.pressed !== null) change["on the ground"] = gathered(at, spec.pressed[now.frame]);
    return change;
  }

  // One call for all traces: plotly draws once.
  function draw() {
    const change = update();
    const moved = Object.keys(change);
    const wanted = { x: [], y: [], z: [] };
    moved.forEach((name) => ["x", "y", "z"].forEach((axis) => wanted[axis].push(change[name][axis])));
    for (const name of colorable) {
      const color = change[name].color;
      if (color !== undefined) plot.data[names.indexOf(name)].line.color = color;
    }
    tell();
    return Plotly.restyle(plot, wanted, moved.map((name) => names.indexOf(name)));
  }

  function tell() {
    if (real !== null) {
      byId("share").textContent = `${(100 * Number(byId("amplitude").value)).toFixed(1)} % of the size`;
      return;
    }
    if (frames > 1) byId("told").textContent = `t = ${spec.time[now.frame].toFixed(3)} s`;
    byId("scrub").value = now.frame;
  }

  // ---- time ----

  const last = spec.time === null ? 1 : spec.time[frames - 1];
  const first = spec.time === null ? 0 : spec.time[0];

  function frameAt(time) {
    let [low, high] = [0, frames - 1];
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (spec.time[middle] <= time) low = middle;
      else high = middle;
    }
    return spec.time[high] <= time ? high : low;
  }

  let before = 0;
  let started = 0;
  async function step(moment, start) {
    if (!now.playing || start !== started) return;
    const again = () => requestAnimationFrame((next) => step(next, start));
    // Drawing puts the eye where the layout has it, and plotly tells the layout when the mouse is let
    // go: the motion waits while the view is turned.
    if (now.turning) {
      before = moment;
      again();
      return;
    }
    now.clock += (Number(byId("speed").value) * (moment - before)) / 1000;
    before = moment;
    if (real === null) {
      if (now.clock > last) now.clock = first;
      now.frame = frameAt(now.clock);
    }
    await draw();
    again();
  }

  function play(on) {
    now.playing = on;
    byId("play").textContent = on ? "Pause" : "Play";
    if (!on) return;
    if (real === null && now.frame === frames - 1) now.clock = first;
    const start = ++started;
    requestAnimationFrame((moment) => {
      before = moment;
      step(moment, start);
    });
  }

  // ---- controls ----

  const show = (...ids) => ids.forEach((id) => (byId(id).hidden = false));
  if (frames > 1) {
    now.clock = first;
    byId("scrub").max = frames - 1;
    byId("scrub").addEventListener("input", () => {
      play(false);
      now.frame = Number(byId("scrub").value);
      now.clock = spec.time[now.frame];
      draw();
    });
    show("play", "scrubber", "told", "speeds");
  }
  if (real !== null) {
    spec.labels.forEach((label, k) => byId("mode").add(new Option(label, k)));
    byId("amplitude").max = spec.mostAmplitude;
    byId("amplitude").value = spec.amplitude;
    for (const id of ["mode", "amplitude"]) byId(id).addEventListener("input", () => now.playing || draw());
    show("play", "speeds", "modes", "amplitudes");
  }
  plot.addEventListener("pointerdown", () => (now.turning = true));
  for (const end of ["pointerup", "pointercancel"]) window.addEventListener(end, () => (now.turning = false));
  byId("play").addEventListener("click", () => play(!now.playing));
  Object.keys(spec.colors).forEach((name) => byId("color").add(new Option(name, name)));
  byId("color").addEventListener("input", choose);
  if (Object.keys(spec.colors).length) show("colors");
  byId("numbers").addEventListener("input", () => {
    const mode = byId("numbers").checked ? "markers+text" : "markers";
    Plotly.restyle(plot, { mode }, [names.indexOf("nodes")]);
  });

  const plain = Object.fromEntries(
    colorable.map((name) => [name, spec.figure.data[names.indexOf(name)].line]),
  );

  // Our own legend and colour bar: plotly would draw its own anew in every state.
  const gradient = `linear-gradient(to right, ${spec.scale.map((step) => step[1]).join(", ")})`;
  function explain(colored) {
    const rows = spec.figure.data.filter((trace) => trace.showlegend !== false);
    byId("keys").replaceChildren(
      ...rows.map((trace) => {
        const row = document.createElement("div");
        const line = plain[trace.name] ?? trace.line;
        const sample = document.createElement(line ? "i" : "b");
        if (line) {
          const style = { dot: "dotted", dash: "dashed" }[line.dash] ?? "solid";
          sample.style.borderTop = `${Math.max(line.width / 2, 2)}px ${style} ${line.color}`;
          if (colored.includes(trace.name) && !line.dash) {
            sample.style.height = sample.style.borderTopWidth;
            sample.style.borderTop = "none";
            sample.style.background = gradient;
          }
        } else {
          sample.textContent = trace.marker ? { "diamond-open": "◇", square: "■" }[trace.marker.symbol] ?? "●" : "▰";
          sample.style.color = trace.marker ? trace.marker.color : "#bdbdbd";
        }
        row.append(sample, trace.name);
        return row;
      }),
    );
  }

  function choose() {
    const name = byId("color").value;
    const most = spec.colors[name] || 1;
    const colored = !name ? [] : colorable.filter((each) => byShare() || !bars.includes(each));
    for (const each of colorable) {
      const { color, ...look } = plain[each];
      plot.data[names.indexOf(each)].line = colored.includes(each)
        ? { ...look, colorscale: spec.scale, cmin: 0, cmax: most }
        : { ...plain[each] };
    }
    byId("scale").hidden = !name;
    byId("scale").firstChild.textContent = name;
    const ticks = [0, 0.25, 0.5, 0.75, 1].map((part) => {
      const mark = document.createElement("span");
      mark.style.setProperty("--part", part);
      mark.textContent = part ? (part * most).toPrecision(3) : "0";
      return mark;
    });
    byId("marks").replaceChildren(...ticks);
    explain(colored);
    Plotly.Plots.resize(plot);
    return draw();
  }

  const figure = spec.figure;
  const given = Object.keys(spec.colors)[0]; // undefined without forces
  byId("scale").hidden = given === undefined;
  byId("scale").firstChild.textContent = given ?? "";
  explain([]); // it takes room in a narrow window
  // The eye sees as much as fits the height: in a window that is narrow, all is drawn smaller.
  const room = Math.min(1, (1.05 * plot.clientWidth) / plot.clientHeight);
  const edges = figure.layout.scene.aspectratio;
  for (const axis of ["x", "y", "z"]) edges[axis] *= room;
  await Plotly.newPlot(plot, figure.data, figure.layout, {
    responsive: true,
    displaylogo: false,
    modeBarButtons: [["toImage", "resetCameraDefault3d"]],
  });
  byId("color").value = given ?? "";
  await choose();
  document.body.dataset.ready = "yes";
})();
