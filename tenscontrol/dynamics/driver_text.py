"""The parts of the C text that are the same for every scene; see driver.py."""

# CasADi's code of the kernels follows: for this file only, to be put into the loops.
# Calls of the library's fmax and fmin would keep the loops from being fast; these give the same.
HEAD = """\
#include <math.h>
#include <string.h>
static inline double larger(double x, double y) { return x > y || y != y ? x : y; }
static inline double smaller(double x, double y) { return x < y || y != y ? x : y; }
#undef fmax
#undef fmin
#define fmax larger
#define fmin smaller
#define CASADI_SYMBOL_EXPORT static inline
"""

EXPORT = """\
#if defined(_WIN32)
#define EXPORTED __declspec(dllexport)
#else
#define EXPORTED __attribute__((visibility("default")))
#endif
"""

# Every node is free: the state is the nodes. A null argument means zeros, as CasADi has it.
_GIVEN = """\
static double zeros[LARGEST];
static const double *given(const double *array) { return array ? array : zeros; }
"""
FREE = (
    _GIVEN
    + """\
static const double *positions(const double *q, double *w) { (void)w; return q; }
static const double *velocities(const double *v, double *w) { (void)w; return v; }
"""
)

# Some nodes are fixed: all nodes are put together in the work memory.
SUPPORTED = (
    _GIVEN
    + """\
static void spread(const double *from, double *to) {
  for (int i = 0; i < FREE; ++i) memcpy(to + free_nodes[i], from + 3 * i, 3 * sizeof(double));
}
static const double *positions(const double *q, double *w) {
  memcpy(w, places, sizeof(places));
  spread(q, w);
  return w;
}
static const double *velocities(const double *v, double *w) {
  w += 3 * NODES;
  memset(w, 0, 3 * NODES * sizeof(double));
  spread(v, w);
  return w;
}
"""
)

LOOP = """\
static void %(name)s(%(arrays)s) {
  for (int i = 0; i < %(count)d; ++i) {
%(body)s
  }
}
"""

LOADED = "memcpy(f, load, sizeof(load));"
UNLOADED = "memset(f, 0, 3 * NODES * sizeof(double));"

FORCES = """\
static void forces(const double *p, const double *v, const double *u, const double *taut,
                   double *f) {
  (void)v; (void)taut;
  %(start)s
%(calls)s
}
"""

SLOPE = """\
EXPORTED int slope(const double **arg, double **res, casadi_int *iw, double *w, int mem) {
  const double *x = given(arg[0]), *u = given(arg[1]), *taut = given(arg[2]);
  const double *p = positions(x, w), *v = velocities(x + 3 * FREE, w);
  double *f = w + 6 * NODES, *a;
  (void)iw; (void)mem;
  if (!res[0]) return 0;
  a = res[0] + 3 * FREE;
  forces(p, v, u, taut, f);
  memcpy(res[0], x + 3 * FREE, 3 * FREE * sizeof(double));
%(calls)s
  return 0;
}
"""

_FORCE = """\
EXPORTED int force(const double **arg, double **res, casadi_int *iw, double *w, int mem) {
  const double *p = positions(given(arg[0]), w), *v = velocities(given(arg[1]), w);
  const double *u = given(arg[2]), *taut = given(arg[3]);
  (void)iw; (void)mem;
  if (!res[0]) return 0;
%s
  return 0;
}
"""
FORCE_FREE = _FORCE % "  forces(p, v, u, taut, res[0]);"
FORCE_SUPPORTED = (
    _FORCE
    % """\
  forces(p, v, u, taut, w + 6 * NODES);
  for (int i = 0; i < FREE; ++i)
    memcpy(res[0] + 3 * i, w + 6 * NODES + free_nodes[i], 3 * sizeof(double));"""
)

GAP = """\
EXPORTED int gap(const double **arg, double **res, casadi_int *iw, double *w, int mem) {
  const double *x = given(arg[0]), *u = given(arg[1]);
  const double *p = positions(x, w), *v = velocities(x + 3 * FREE, w);
  double *gap = res[0] ? res[0] : w + 6 * NODES;
  double *rate = res[1] ? res[1] : w + 6 * NODES + LARGEST;
  (void)iw; (void)mem; (void)u; (void)p; (void)v; (void)gap; (void)rate;
%(calls)s
  return 0;
}
"""

# The work memory holds positions, velocities, then forces, or what nobody asked for.
INTERFACE = """\
static const casadi_int %(name)s_shapes_in[%(inputs)d][3] = {%(shapes_in)s};
static const casadi_int %(name)s_shapes_out[%(outputs)d][3] = {%(shapes_out)s};
EXPORTED casadi_int %(name)s_n_in(void) { return %(inputs)d; }
EXPORTED casadi_int %(name)s_n_out(void) { return %(outputs)d; }
EXPORTED const casadi_int *%(name)s_sparsity_in(casadi_int i) {
  return i < %(inputs)d ? %(name)s_shapes_in[i] : 0;
}
EXPORTED const casadi_int *%(name)s_sparsity_out(casadi_int i) {
  return i < %(outputs)d ? %(name)s_shapes_out[i] : 0;
}
EXPORTED int %(name)s_work(casadi_int *sz_arg, casadi_int *sz_res, casadi_int *sz_iw,
                           casadi_int *sz_w) {
  if (sz_arg) *sz_arg = %(inputs)d;
  if (sz_res) *sz_res = %(outputs)d;
  if (sz_iw) *sz_iw = 0;
  if (sz_w) *sz_w = 9 * NODES + 2 * LARGEST;
  return 0;
}
"""
