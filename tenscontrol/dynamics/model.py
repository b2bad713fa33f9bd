"""The model: Goyal & Skelton's N̈ M_s + N K_s = W as CasADi functions."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from copy import copy
from dataclasses import fields
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.dynamics import kernel
from tenscontrol.dynamics.contact_laws import ContactLaw, Contacts
from tenscontrol.dynamics.equation import (
    FORMS,
    Equation,
    InputLayout,
    gravity_forces,
    gravity_vector,
    in_time,
)
from tenscontrol.dynamics.evaluator import Function, Prepared, built
from tenscontrol.dynamics.forces import Forces, terms_of
from tenscontrol.dynamics.forms.elimination import members_alone
from tenscontrol.dynamics.forms.loops import loops_functions
from tenscontrol.dynamics.forms.mapped import mapped_functions
from tenscontrol.dynamics.machine_code import compiler, if_compiled
from tenscontrol.dynamics.shared_equation import with_values
from tenscontrol.dynamics.string_force import StringForce
from tenscontrol.dynamics.string_laws import StringLaw
from tenscontrol.dynamics.symbolic_model import SymbolicModel
from tenscontrol.properties import cached_property
from tenscontrol.structure.blocks import node_mass
from tenscontrol.structure.structure import Structure

if TYPE_CHECKING:
    from scipy.sparse import csr_array

#: Bars and strings up to which every member is written out. Without a compiler, operations on all
#: members at once are as fast from 36 members on, five times as fast from 180 on, and built in no
#: time where 1500 written out take 0.3 s. With one, loops are as fast even for 12, and compile in
#: 0.3 s where 84 members written out take 4 to 13 s. Below, a flat expression is kept: it can be
#: put into those of a step, and differentiated. Joined bars count by their instructions.
LARGEST_FLAT = 40

# Of inputs that are polynomials in time.
_MOST_DEGREE = 20

# Functions that can be had of all nodes.
_OF_ALL_NODES = (
    "string_force_density", "kinetic_energy", "potential_energy", "elastic_energy", "momentum",
    "string_motion", "winding",
)  # fmt: skip


class Model:
    """Equations of motion of a structure: rigid bars, strings, loads, supports and ground.

    What a model does not have, such as a load, damping or ground, adds no input and no code to its
    functions. The state is ``x = [vec(N); vec(Ṅ)]``, node by node: x1 y1 z1 x2 …, then the
    velocities.

    Parameters
    ----------
    structure : Structure
    strings : StringLaw, optional
        :class:`LinearStrings` or :class:`ElasticStrings`. Needed only where
        the rest length is an input. Without strings a law does nothing.
    external_force : bool or array_like, shape (d, n), or 0
        True: the functions take a load W on the free nodes, N, as a further
        input. An array: that load is built in.
    gravity : float or array_like, shape (d,), optional
        Acceleration of free fall, m/s²; a number, at least 0, is downward, along −z, in the plane
        along −y; a vector has the direction of the fall. The weight of a bar acts half at each end.
    ground : ContactLaw or sequence of ContactLaw, optional
        :class:`Ground`, or several: a corner, a wall, a step. Without it nothing stops a fall.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind, or the parameters of the string
        law do not fit the number of strings.

    Notes
    -----
    Goyal & Skelton, *Dynamics of Class 1 Tensegrity Systems Including Cable
    Mass*, eqs. (2), (7)–(9). Bars that share nodes are solved for together, by Lagrange's
    multipliers λ and sparse factors; all others in closed form. N̈ is affine in γ at any state.
    If nodes are fixed, all functions are in the free nodes only: n is then their number, and
    the positions of fixed nodes are constants. Nodes on rollers count as free. Their components
    along the fixed axis have no effect, and x leaves them out.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> prism = tc.prism()
    >>> model = tc.Model(prism)
    >>> model.acceleration
    Function(acceleration:(N[3x6],Nd[3x6],gamma[9])->(Ndd[3x6]) SXFunction)
    >>> rest = tc.prestress(prism, force_density=10.0)
    >>> Ndd = model.acceleration(prism.nodes, np.zeros((3, 6)), rest.force_density)
    >>> bool(abs(np.array(Ndd)).max() < 1e-12)
    True
    """

    def __init__(
        self,
        structure: Structure,
        strings: StringLaw | None = None,
        external_force: object = False,
        gravity: object = None,
        ground: ContactLaw | Sequence[ContactLaw] | None = None,
    ) -> None:
        validation.instance(
            "structure", structure, Structure, "make one by Structure(...) or prism(...)"
        )
        if strings is not None:
            validation.instance("strings", strings, StringLaw, "use LinearStrings(stiffness=...)")
            strings = strings.for_count(len(structure.strings))
        shape = structure.nodes.shape
        load, fall = np.zeros(shape), np.zeros(shape[0])
        takes_load = False
        if external_force is None or isinstance(external_force, bool | np.bool_):
            meaning = "whether the functions take a load W; or a built-in load, shape (d, n)"
            takes_load = external_force is not None and validation.truth(
                "external_force", external_force, meaning
            )
        else:
            load += validation.node_forces("external_force", external_force, shape)
        if gravity is not None:
            fall = gravity_vector(gravity, structure.dimension)
        self._structure = structure
        self._strings = strings
        others = {"ground": ground}
        self._terms = terms_of(structure, others)
        self._forces: dict[bool, Forces] = {}  # by whether it is without a law of strings
        self._external_force = takes_load
        masses = structure.bar_mass, structure.point_mass
        self._constant_force = frozen(load + gravity_forces(structure, fall, *masses))
        self._load, self._gravity = frozen(load), frozen(fall)
        self._arguments = others | {
            "structure": structure, "strings": strings, "external_force": takes_load or self._load,
            "gravity": self._gravity, "ground": self.ground,
        }  # fmt: skip
        self._prepared = Prepared()
        self._shared: tuple[Model, tuple[str, ...]] | None = None

    @property
    def structure(self) -> Structure:
        """The structure that the model was built for."""
        return self._structure

    @property
    def strings(self) -> StringLaw | None:
        """The string law, or None."""
        return self._strings

    @property
    def ground(self) -> tuple[ContactLaw, ...]:
        """The contact laws of the ground; empty where there is none."""
        return () if self.contacts is None else self.contacts.laws

    @cached_property
    def contacts(self) -> Contacts | None:
        """The nodes that can touch the ground; None where there is none."""
        return self.forces("force_density").contacts

    @cached_property
    def is_small(self) -> bool:
        """Whether equations write out every member, by what members cost; not for users."""
        members = len(self._structure.bars) + len(self._structure.strings)
        return members <= LARGEST_FLAT >= members_alone(self._structure)

    @property
    def arguments(self) -> dict[str, Any]:
        """What the model was made from, by name."""
        return dict(self._arguments)

    def replace(self, **arguments: Any) -> Model:
        """Return the model with other arguments.

        Parameters
        ----------
        **arguments
            Of :class:`Model`, those that differ.

        Returns
        -------
        Model

        Raises
        ------
        TypeError, ValueError
            As :class:`Model` does.

        Examples
        --------
        >>> import tenscontrol as tc
        >>> model = tc.Model(tc.prism(), strings=tc.LinearStrings(stiffness=100.0))
        >>> heavy = model.replace(gravity=9.81)
        >>> heavy.gravity, float(heavy.strings.stiffness[0])
        (array([ 0.  ,  0.  , -9.81]), 100.0)
        """
        return Model(**(self._arguments | arguments))

    def forces(self, input: str) -> Forces:
        """Return the forces on the nodes, without loads and weights.

        Parameters
        ----------
        input : {"force_density", "rest_length"}
            Input of the strings.
        """
        law = self._needed_strings() if input == "rest_length" else None
        known = self._forces.get(law is None)
        if known is None:
            known = self._forces[law is None] = Forces(self._structure, law, self._terms)
        return known

    @property
    def has_external_force(self) -> bool:
        """Whether the functions take a load W."""
        return self._external_force

    @property
    def constant_force(self) -> FloatArray:
        """Weights and built-in load on the nodes, N, shape (d, n), all nodes."""
        return self._constant_force

    @cached_property
    def is_loaded(self) -> bool:
        """Whether there is any weight or built-in load; not for users."""
        return bool(self._constant_force.any())

    @cached_property
    def is_pulled_down(self) -> bool:
        """Whether weights and built-in load pull down in all; not for users."""
        return float(self._constant_force[-1].sum()) < 0

    @property
    def gravity(self) -> FloatArray:
        """Acceleration of free fall, m/s², shape (d,); zero if none was given."""
        return self._gravity

    @property
    def built_in_load(self) -> FloatArray:
        """The load that was built in, N, shape (d, n), without weights."""
        return self._load

    @property
    def prepared(self) -> Prepared:
        """What was built for this model once, for every later call; not for users."""
        return self._prepared

    def __repr__(self) -> str:
        law = "" if self._strings is None else f", {type(self._strings).__name__}"
        return f"Model({self._structure!r}{law})"

    # ---- functions of positions, velocities and γ ----

    @built
    def acceleration(self) -> ca.Function:
        """``(N, Nd, gamma[, W]) -> Ndd``: node accelerations, shape (d, n), m/s²."""
        s = self._symbols()
        Ndd = self._accelerations(s, self._on_nodes(s, "force_density"))
        return self._function("acceleration", s, "N Nd gamma W", Ndd=Ndd)

    @built
    def bar_force_density(self) -> ca.Function:
        """``(N, Nd, gamma[, W]) -> lambda``: λ of each bar, shape (β,), N/m, compression > 0."""
        s = self._symbols()
        outputs = {"lambda": ca.densify(self._lambda(s).T)}
        return self._function("bar_force_density", s, "N Nd gamma W", **outputs)

    @built
    def stiffness_matrix(self) -> ca.Function:
        """``(N, Nd, gamma[, W]) -> K_s``: eq. (9), sparse, shape (n, n), N/m.

        Columns are in the order of the nodes. For nodes ordered as in the
        paper, ``[N_b N_s]``, that is eq. (9) letter by letter.
        """
        s = self._symbols()
        S = kernel.differences(s["nodes"], self._structure.segments)
        gamma = kernel.segment_force_density(self._structure, S, s["gamma"].T).T
        K_s = kernel.stiffness(self._structure, gamma, self._lambda(s))
        return self._function("stiffness_matrix", s, "N Nd gamma W", K_s=K_s)

    def mass_matrix(self) -> csr_array:
        """Return M_s of eq. (8), sparse, shape (n, n), kg, columns in the order of the nodes.

        Examples
        --------
        >>> import tenscontrol as tc
        >>> tc.Model(tc.prism(bar_mass=6.0)).mass_matrix()[[0, 4]][:, [0, 4]].toarray()
        array([[2., 1.],
               [1., 2.]])
        """
        return node_mass(self._structure)

    # ---- functions of the state ----

    @built
    def dynamics(self) -> ca.Function:
        """``(x, gamma[, W]) -> xdot``: the state equation with γ as the input."""
        s = self._symbols()
        xdot = self._xdot(s, self._on_nodes(s, "force_density"))
        return self._function("dynamics", s, "x gamma W", xdot=xdot)

    @built
    def rest_length_dynamics(self) -> ca.Function:
        """``(x, rest_length[, W]) -> xdot``: the state equation with the rest length as the input.

        Raises ValueError if the model has no string law.
        """
        s = self._symbols()
        xdot = self._xdot(s, self._on_nodes(s, "rest_length"))
        return self._function("rest_length_dynamics", s, "x rest_length W", xdot=xdot)

    @property
    def M_s(self) -> csr_array:  # noqa: N802
        """The paper's name of :meth:`mass_matrix`: M_s of eq. (8), sparse, shape (n, n), kg."""
        return self.mass_matrix()

    @property
    def K_s(self) -> ca.Function:  # noqa: N802
        """The paper's name of :attr:`stiffness_matrix`: ``(N, Nd, gamma[, W]) -> K_s``, N/m."""
        return self.stiffness_matrix

    def symbolic(
        self, input: str = "force_density", parameters: Sequence[str] = ()
    ) -> SymbolicModel:
        """Return the equation of motion as symbols and matrices, by the paper's names.

        Parameters
        ----------
        input : {"force_density", "rest_length"}
            What is a symbol of the strings: γ, or rest lengths, of which γ is then an expression.
        parameters : sequence of str
            What else is a symbol and not a number: ``"bar_mass"``, ``"point_mass"`` and, with rest
            lengths as the input, fields of the string law, such as ``"stiffness"`` and
            ``"damping"``.

        Returns
        -------
        SymbolicModel

        Raises
        ------
        ValueError
            If a word is unknown, the model has no string law for rest lengths, or masses are asked
            for where bars share nodes.

        Examples
        --------
        >>> import casadi as ca, tenscontrol as tc
        >>> model = tc.Model(tc.prism(), strings=tc.LinearStrings(stiffness=100.0))
        >>> s = model.symbolic("rest_length", parameters=["bar_mass", "stiffness"])
        >>> s
        SymbolicModel(6 nodes, d = 3, input rest_length, symbols bar_mass, stiffness)
        >>> error = s.Ndd @ s.M_s + s.N @ s.K_s - s.W  # the paper's eq. (7)
        >>> given = [s.x, s.rest_length, *s.parameters.values()]
        >>> residual = ca.Function("residual", given, [error])
        >>> x = ca.vertcat(ca.vec(ca.DM(model.structure.nodes)), ca.DM.ones(18))
        >>> float(ca.norm_inf(ca.vec(residual(x, 0.6, 2.0, 50.0)))) < 1e-12
        True
        """
        validation.choice("input", input, ("force_density", "rest_length"))
        structure, s = self._structure, self._symbols()
        law = self._needed_strings() if input == "rest_length" else None
        own = {name: ca.SX.sym(name, size) for name, size in self._parameter_sizes(parameters, law)}
        masses = kernel.Masses.of(structure, own)
        if law is not None:
            law = law.with_parameters(own)
        forces = Forces(structure, law, self._terms)
        nodes, velocities, load = s["nodes"], s["velocities"], s["load"]
        if masses is not None and self._gravity.any():  # weights are expressions too
            load += kernel.weights(structure, self._gravity, masses)
            load -= ca.DM(self._constant_force - self._load)
        u = s["gamma"] if law is None else s["rest_length"]
        acting = forces.on_nodes(nodes, velocities, u, load)
        gamma = u if law is None else StringForce(structure, law).force_density(
            nodes, velocities, u
        )  # fmt: skip
        without_strings = Forces(structure, None, self._terms)
        S = kernel.differences(nodes, structure.segments)
        by_segment = kernel.segment_force_density(structure, S, gamma.T).T
        lam = kernel.bar_force_density(structure, nodes, velocities, acting, masses)
        return SymbolicModel(
            x=s["x"],
            N=nodes,
            Nd=velocities,
            Ndd=ca.densify(kernel.accelerations(structure, nodes, velocities, acting, masses)),
            gamma=gamma,
            rest_length=None if law is None else u,
            lam=ca.densify(lam.T),
            W=ca.densify(without_strings.on_nodes(nodes, velocities, ca.SX(*u.shape), load)),
            load=s["W"] if self._external_force else None,
            M_s=ca.SX(kernel.mass_matrix(structure, masses)),
            K_s=kernel.stiffness(structure, by_segment, lam),
            parameters=MappingProxyType(own),
        )

    def state_equation(self, input: str) -> ca.Function:
        """Return the state equation with the held input as its input.

        Parameters
        ----------
        input : {"force_density", "rest_length"}

        Returns
        -------
        casadi.Function
            :attr:`dynamics` or :attr:`rest_length_dynamics`.

        Raises
        ------
        ValueError
            If ``input`` is another word, or the model has no string law for it.
        """
        validation.choice("input", input, ("force_density", "rest_length"))
        return self.dynamics if input == "force_density" else self.rest_length_dynamics

    def equation(
        self,
        input: str,
        external_force: FloatArray | None = None,
        form: str = "auto",
        *,
        degree: int = 0,
        load_input: bool = False,
        offset_input: bool = False,
        length_input: bool = False,
        parameters: Sequence[str] = (),
    ) -> Equation:
        """Return the state equation for an integrator, for fixed slack and taut strings.

        Parameters
        ----------
        input : {"force_density", "rest_length"}
        external_force : ndarray, shape (d, n), optional
            Load that acts all the time, N, beside what is built in; for a
            model built with ``external_force=True``.
        form : {"auto", "flat", "mapped", "loops"}
            How the functions are built. ``"flat"``: one expression with every member written out,
            to be put into larger expressions. ``"mapped"``: operations on all members at once.
            ``"loops"``: loops over the members in compiled C, without derivatives; needs a
            compiler. ``"auto"``: flat up to 40 members, beyond them loops where there is a C
            compiler, else mapped; bars that are joined count as two to ten. ``.form`` of the
            equation says which.
        degree : int
            Degree of the polynomials in time that the input is made of; 0 where it is held.
        load_input, offset_input, length_input : bool
            Whether the load on all nodes, N, is a further input, in place of all others;
            the displacement of nodes with their supports, m, which strings see; and the lengths of
            all bars, m, whose mass stays spread evenly over them. See :class:`InputLayout`.
        parameters : sequence of str
            Further inputs, a number a string, bar or node: parameters of the string law by name,
            and unless bars share nodes ``"bar_mass"`` and ``"point_mass"``. The form is "flat".

        Raises
        ------
        ValueError
            If ``input`` or ``form`` is another word, the model has no string law for it, or
            ``form`` is ``"loops"`` where lengths of bars are inputs.
        FileNotFoundError
            If ``form`` is ``"loops"`` and there is no C compiler.
        """
        validation.choice("input", input, ("force_density", "rest_length"))
        validation.choice("form", form, ("auto", *FORMS))
        forces = self.forces(input)
        law = forces.law
        load = self._constant_force
        if external_force is not None:
            load = load + validation.node_forces("external_force", external_force, load.shape)
        sizes = self._parameter_sizes(parameters, law)
        form = "flat" if sizes else form
        if form == "auto":
            no_loops = length_input or (not self.is_small and compiler() is None)
            form = "flat" if self.is_small else "mapped" if no_loops else "auto"
        degree = validation.whole_number("degree", degree, 0, _MOST_DEGREE)
        validation.truth("load_input", load_input, "whether the load is an input")
        validation.truth("offset_input", offset_input, "whether supports move")
        validation.truth("length_input", length_input, "whether lengths of bars are driven")
        if length_input and form == "loops":
            raise ValueError("form 'loops' takes no lengths of bars as inputs; use 'mapped'")
        entries = self._structure.nodes.size
        layout = InputLayout(
            len(self._structure.strings), entries * load_input, entries * offset_input, degree,
            sizes, len(self._structure.bars) * length_input,
        )  # fmt: skip
        if load_input:
            load = np.zeros_like(load)

        def functions_of(form: str) -> tuple[ca.Function, ...]:
            if form == "flat" and self._shares(load_input) and not sizes:
                return self._shared_functions(
                    lambda model, names: model.equation(
                        input, external_force, form, degree=degree, load_input=load_input,
                        offset_input=offset_input, length_input=length_input, parameters=names,
                    )
                )  # fmt: skip
            make = {"flat": self._flat_functions, "mapped": mapped_functions}.get(
                form, loops_functions
            )
            symbol = ca.SX.sym if form == "flat" else ca.MX.sym
            return in_time(make(forces, load, layout), layout, law is not None, symbol)

        def build(form: str) -> Equation:
            slope, gap, force = functions_of(form)
            damped = forces.is_velocity_dependent or "damping" in parameters
            constant = frozen(load) if load.any() else None
            return Equation(slope, gap, force, damped, forces, constant, form, layout)

        def of(form: str, make: Callable[[], Equation]) -> Equation:
            # Another compiler makes another library.
            by = compiler() if form in ("auto", "loops") else None
            return self._prepared.get(("equation", input, load.tobytes(), form, layout, by), make)

        def loops() -> Equation:
            return of("loops", lambda: build("loops"))

        def mapped() -> Equation:
            return of("mapped", lambda: build("mapped"))

        if form == "auto":
            return of("auto", lambda: if_compiled(loops) or mapped())
        return of(form, lambda: build(form))

    def sharing(self, other: Model, names: Sequence[str]) -> Model:
        """Return the same model, but taking its equations from another, with its own parameters.

        Parameters
        ----------
        other : Model
            Which differs in no more than the parameters.
        names : sequence of str
            As of :meth:`equation`; where it does not take one of them, nothing is shared.
        """
        law = () if self._strings is None else (field.name for field in fields(self._strings))
        known = {*law, *(() if self._structure.blocks else ("bar_mass", "point_mass"))}
        same = copy(self)
        shared = (other, tuple(names)) if names and known.issuperset(names) else None
        vars(same).update(_prepared=Prepared(), _shared=shared)
        return same

    def shared_function(
        self, key: Hashable, equation: Equation, build: Callable[[Equation], ca.Function]
    ) -> ca.Function:
        """Return a function of an equation of this model, whose second input is u.

        It is built for the equation, or taken from the model that this one shares equations with.

        Parameters
        ----------
        key : hashable
            Of the function, the same in all models.
        equation : Equation
            Of this model.
        build : callable
            ``equation -> function``.
        """
        layout = equation.layout
        if equation.form != "flat" or layout.lengths or not self._shares(bool(layout.load)):
            return build(equation)
        assert self._shared is not None  # it shares
        other, names = self._shared
        general = other.equation(
            "force_density" if equation.law is None else "rest_length", degree=layout.degree,
            load_input=bool(layout.load), form="flat", parameters=names,
        )  # fmt: skip
        function = other.prepared.get((key, "of parameters", names), lambda: build(general))
        return with_values(function, 1, general.layout, self._values_of(names))

    def _shares(self, load_input: bool) -> bool:
        """Whether equations are taken from another model, whose constant load is the same."""
        if self._shared is None:
            return False
        return load_input or np.array_equal(self._shared[0].constant_force, self._constant_force)

    def _shared_functions(
        self, equation_of: Callable[[Model, tuple[str, ...]], Equation]
    ) -> tuple[ca.Function, ...]:
        """Return slope, gap and force of the model that this one shares equations with."""
        assert self._shared is not None  # it shares
        general = equation_of(*self._shared)
        assert general.force is not None  # it is that of a structure
        values = self._values_of(self._shared[1])
        functions = zip((general.slope, general.gap, general.force), (1, 1, 2), strict=True)
        return tuple(with_values(by, u, general.layout, values) for by, u in functions)

    def _values_of(self, names: Sequence[str]) -> dict[str, FloatArray]:
        """Return parameters of the string law and masses, one number a member."""
        structure, count = self._structure, len(self._structure.strings)
        masses = {"bar_mass": structure.bar_mass, "point_mass": structure.point_mass}
        return {
            name: masses[name]
            if name in masses
            else np.broadcast_to(getattr(self._strings, name), (count,))
            for name in names
        }

    def _parameter_sizes(
        self, names: Sequence[str], law: StringLaw | None
    ) -> tuple[tuple[str, int], ...]:
        given = validation.items("parameters", names, "names")
        if not given:
            return ()
        structure = self._structure
        known = {"bar_mass": len(structure.bars), "point_mass": structure.nodes.shape[1]}
        known = {} if structure.blocks else known
        known |= {field.name: len(structure.strings) for field in (fields(law) if law else ())}
        return tuple((validation.choice("parameters", name, known), known[name]) for name in given)

    def _flat_functions(
        self, forces: Forces, load: FloatArray, layout: InputLayout
    ) -> tuple[ca.Function, ...]:
        """Return slope, gap and force, every member written out."""
        structure, law, s = self._structure, forces.law, self._symbols()
        acting = ca.sparsify(ca.DM(load)) if load.any() else None
        u = s["gamma"] if law is None else s["rest_length"]
        given = u
        own = {name: ca.SX.sym(name, size) for name, size in layout.parameters}
        if layout.load:
            acting = ca.SX.sym("load", *structure.nodes.shape)
            given = ca.vertcat(given, ca.vec(acting))
        if own:
            given, s["masses"] = ca.vertcat(given, *own.values()), kernel.Masses.of(structure, own)
            if law is not None:
                forces = Forces(structure, law.with_parameters(own), forces.terms)
        ends = s["nodes"], s["velocities"]
        if layout.offset:
            # Forces see where nodes are; bars only where they are beside their supports.
            offsets = [ca.SX.sym(name, *structure.nodes.shape) for name in ("offset", "rate")]
            ends = s["nodes"] + offsets[0], s["velocities"] + offsets[1]
            given = ca.vertcat(given, *map(ca.vec, offsets))
        if layout.lengths:
            extension = ca.SX.sym("extension", layout.lengths)
            given, s["extension"] = ca.vertcat(given, extension), extension.T
        taut = ca.SX.sym("taut", forces.switches)
        on_nodes = forces.on_nodes(*ends, u, acting, taut)
        on_free = ca.densify(on_nodes[:, structure.free.tolist()])
        q, v = (kernel.free_entries(structure, s[name]) for name in ("N", "Nd"))
        on_free = kernel.free_entries(structure, on_free)
        gaps = [ca.densify(column) for column in forces.gaps(*ends, u)]
        return (
            Function("slope", [s["x"], given, taut], [self._xdot(s, on_nodes)]),
            Function("gap", [s["x"], given], gaps),
            Function("force", [q, v, given, taut], [on_free]),
        )

    @built
    def string_force_density(self) -> ca.Function:
        """``(x, rest_length) -> gamma``: γ of each string by the string law, N/m."""
        return self._string_force_density(self._symbols())

    @built
    def kinetic_energy(self) -> ca.Function:
        """``(x) -> energy``: ½ tr(Ṅ M_s Ṅᵀ), J."""
        return self._kinetic_energy(self._symbols())

    @built
    def potential_energy(self) -> ca.Function:
        """``(x, gamma) -> energy``: ½ Σ γ l², J: what strings store whose γ is held."""
        return self._potential_energy(self._symbols())

    @built
    def elastic_energy(self) -> ca.Function:
        """``(x, rest_length) -> energy``: what strings store whose rest length is held, J."""
        return self._elastic_energy(self._symbols())

    @built
    def momentum(self) -> ca.Function:
        """``(x) -> (linear, angular)``: kg m/s, and kg m²/s about the origin.

        Shape (3,) each in space; (2,) and (1,) in the plane.
        """
        return self._momentum(self._symbols())

    def of_all_nodes(self, name: str) -> ca.Function:
        """Return an energy, the momentum, γ or what strings do as a function of all nodes.

        Parameters
        ----------
        name : str
            Of the property, ``"string_motion"`` or ``"winding"``. In its x stand the positions and
            velocities of all nodes, those of supports, which may move, among them.
        """
        build = getattr(self, f"_{validation.choice('name', name, _OF_ALL_NODES)}")
        key = "of all nodes", name
        return self._prepared.get(key, lambda: build(self._symbols(every=True)))

    def of_parameters(self, name: str, names: Sequence[str]) -> ca.Function:
        """Return γ or the elastic energy with parameters of the string law as further inputs.

        Parameters
        ----------
        name : {"string_force_density", "elastic_energy"}
        names : sequence of str
        """
        own = {parameter: ca.SX.sym(parameter, len(self._structure.strings)) for parameter in names}
        law = self._needed_strings().with_parameters(own)
        s = self._symbols() | own | {"law": law, "parameters": names}
        return getattr(self, f"_{name}")(s)

    # ---- expressions ----

    def _string_force_density(self, s: dict[str, Any]) -> ca.Function:
        strings = StringForce(self._structure, s.get("law") or self._needed_strings())
        gamma = strings.force_density(s["nodes"], s["velocities"], s["rest_length"])
        return self._function("string_force_density", s, "x rest_length", gamma=gamma)

    def _kinetic_energy(self, s: dict[str, Any]) -> ca.Function:
        momenta = kernel.mass_product(self._structure, s["velocities"])
        energy = ca.sum2(kernel.dots(s["velocities"], momenta)) / 2
        return self._function("kinetic_energy", s, "x", energy=energy)

    def _potential_energy(self, s: dict[str, Any]) -> ca.Function:
        stored = self.forces("force_density").stored_energy(s["nodes"], s["gamma"])
        return self._function("potential_energy", s, "x gamma", energy=ca.densify(stored))

    def _elastic_energy(self, s: dict[str, Any]) -> ca.Function:
        forces = Forces(self._structure, s.get("law") or self._needed_strings(), self._terms)
        energy = ca.densify(forces.stored_energy(s["nodes"], s["rest_length"]))
        return self._function("elastic_energy", s, "x rest_length", energy=energy)

    def _string_motion(self, s: dict[str, Any]) -> ca.Function:
        """``(x) -> (length, rate)``: of each string, m and m/s, shape (α,)."""
        length, rate = kernel.string_motion(self._structure, s["nodes"], s["velocities"])
        outputs = {"length": ca.densify(length.T), "rate": ca.densify(rate.T)}
        return self._function("string_motion", s, "x", **outputs)

    def _winding(self, s: dict[str, Any]) -> ca.Function:
        """``(x, rest_length, rate) -> (stored, force, force_rate, slope)`` of each string.

        Elastic energy, J; the force that winds the string in, ``−∂U/∂l0``, N; its rate under the
        rates of the nodes and of the rest lengths, m/s, N/s; and ``−∂F/∂l0``, N/m. Each of shape
        (α,).
        """
        s["rate"] = ca.SX.sym("rate", len(self._structure.strings))
        x, rest = s["x"], s["rest_length"]
        stored = self.forces("rest_length").strings.stored_energy(s["nodes"], rest)
        # Each string stores by its own rest length alone.
        force = -ca.jtimes(stored, rest, ca.DM.ones(rest.shape))
        slope = -ca.jtimes(force, rest, ca.DM.ones(rest.shape))
        half = x.shape[0] // 2
        moved = ca.vertcat(x[half:], ca.DM.zeros(half))
        change = ca.jtimes(force, x, moved) + ca.jtimes(force, rest, s["rate"])
        outputs = {"stored": stored, "force": force, "force_rate": change, "slope": slope}
        outputs = {name: ca.densify(expression) for name, expression in outputs.items()}
        return self._function("winding", s, "x rest_length rate", **outputs)

    def _momentum(self, s: dict[str, Any]) -> ca.Function:
        momenta, nodes = kernel.mass_product(self._structure, s["velocities"]), s["nodes"]
        if self._structure.dimension == 2:
            angular = ca.sum2(nodes[0, :] * momenta[1, :] - nodes[1, :] * momenta[0, :])
        else:
            angular = sum(
                (ca.cross(nodes[:, i], momenta[:, i]) for i in range(momenta.shape[1])),
                ca.SX(3, 1),
            )
        return self._function("momentum", s, "x", linear=ca.sum2(momenta), angular=angular)

    def _symbols(self, every: bool = False) -> dict[str, Any]:
        """Return fresh symbols, with N and Nd of what is free, or of every node, as parts of x."""
        structure = self._structure
        free, alpha = len(structure.free), len(structure.strings)
        if every:
            nodes, velocities = (ca.SX.sym(name, *structure.nodes.shape) for name in ("N", "Nd"))
            x = ca.vertcat(ca.vec(nodes), ca.vec(velocities))
            held = {name: ca.SX.sym(name, alpha) for name in ("gamma", "rest_length")}
            return {"x": x, "nodes": nodes, "velocities": velocities, **held}
        d = structure.dimension
        N, Nd, W = (ca.SX.sym(name, d, free) for name in ("N", "Nd", "W"))
        load = ca.SX(*structure.nodes.shape)
        if self._external_force:
            load = kernel.all_nodes(structure, W)
        if self._constant_force.any():
            load += ca.sparsify(ca.DM(self._constant_force))
        # All nodes, the fixed ones as constants.
        nodes = kernel.all_nodes(structure, N, structure.nodes)
        velocities = kernel.all_nodes(structure, Nd)
        return {
            "N": N,
            "Nd": Nd,
            "W": W,
            "x": ca.vertcat(*(kernel.free_entries(structure, columns) for columns in (N, Nd))),
            "gamma": ca.SX.sym("gamma", alpha),
            "rest_length": ca.SX.sym("rest_length", alpha),
            "nodes": nodes,
            "velocities": velocities,
            "load": load if load.nnz() else None,
        }

    def _function(self, name: str, s: dict[str, Any], inputs: str, **outputs: Any) -> ca.Function:
        """Return a function of symbols by name; W is an input only if the model takes a load."""
        names = [symbol for symbol in inputs.split() if symbol != "W" or self._external_force]
        names += s.get("parameters", ())
        given = [s[symbol] for symbol in names]
        return Function(name, given, list(outputs.values()), names, list(outputs))

    def _on_nodes(self, s: dict[str, Any], input: str) -> Any:
        u = s["gamma" if input == "force_density" else input]
        return self.forces(input).on_nodes(s["nodes"], s["velocities"], u, s["load"])

    def _accelerations(self, s: dict[str, Any], forces: Any) -> Any:
        """Return the accelerations of nodes that are not fixed."""
        structure, motion = self._structure, (s["nodes"], s["velocities"])
        own = s.get("masses"), s.get("extension")
        Ndd = kernel.accelerations(structure, *motion, forces, *own)
        return ca.densify(Ndd[:, structure.free.tolist()])

    def _xdot(self, s: dict[str, Any], forces: Any) -> Any:
        rates = s["Nd"], self._accelerations(s, forces)
        return ca.vertcat(*(kernel.free_entries(self._structure, columns) for columns in rates))

    def _lambda(self, s: dict[str, Any]) -> Any:
        forces, motion = self._on_nodes(s, "force_density"), (s["nodes"], s["velocities"])
        return kernel.bar_force_density(self._structure, *motion, forces)

    def _needed_strings(self) -> StringLaw:
        if self._strings is None:
            raise ValueError(
                "the model has no string law, so rest lengths have no meaning for it; "
                "build it as Model(structure, strings=LinearStrings(stiffness=...))"
            )
        return self._strings
