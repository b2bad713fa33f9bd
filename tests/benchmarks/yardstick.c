/* The yardstick of member_cost.py: the dynamics of a class-1 tensegrity as one would write them
   in C for this purpose only. All nodes are bar ends and free; the state is positions, then
   velocities, x y z node by node. Built with -O3. */

#include <math.h>
#include <string.h>
#include <time.h>

typedef struct {
  int nodes, strings, bars;
  const int *string, *bar; /* start and end node of each */
  const double *mass;      /* of each bar */
  double stiffness;        /* of every string; 0 where force densities are held */
  double *force;           /* work: 3 a node */
} Scene;

static void pull(const Scene *s, const double *restrict p, const double *restrict u,
                 const double *restrict taut, double *restrict f) {
  memset(f, 0, 3 * s->nodes * sizeof(double));
  for (int i = 0; i < s->strings; ++i) {
    const int a = 3 * s->string[2 * i], b = 3 * s->string[2 * i + 1];
    const double x = p[b] - p[a], y = p[b + 1] - p[a + 1], z = p[b + 2] - p[a + 2];
    double density = u[i];
    if (s->stiffness > 0) {
      const double length = sqrt(x * x + y * y + z * z);
      density = taut[i] != 0 ? s->stiffness * (length - u[i]) / length : 0;
    }
    f[a] += density * x;
    f[a + 1] += density * y;
    f[a + 2] += density * z;
    f[b] -= density * x;
    f[b + 1] -= density * y;
    f[b + 2] -= density * z;
  }
}

static void accelerate(const Scene *s, const double *restrict p, const double *restrict v,
                       const double *restrict f, double *restrict out) {
  for (int i = 0; i < s->bars; ++i) {
    const int a = 3 * s->bar[2 * i], b = 3 * s->bar[2 * i + 1];
    const double m = s->mass[i], bx = p[b] - p[a], by = p[b + 1] - p[a + 1], bz = p[b + 2] - p[a + 2];
    const double dx = v[b] - v[a], dy = v[b + 1] - v[a + 1], dz = v[b + 2] - v[a + 2];
    const double fx = f[b] - f[a], fy = f[b + 1] - f[a + 1], fz = f[b + 2] - f[a + 2];
    const double lambda = -(m / 12 * (dx * dx + dy * dy + dz * dz) + (bx * fx + by * fy + bz * fz) / 2) /
                          (bx * bx + by * by + bz * bz);
    const double r = 1 / m, k = 6 * r * lambda;
    const double hx = 3 * r * fx + k * bx, hy = 3 * r * fy + k * by, hz = 3 * r * fz + k * bz;
    const double cx = r * (f[a] + f[b]), cy = r * (f[a + 1] + f[b + 1]), cz = r * (f[a + 2] + f[b + 2]);
    out[a] = cx - hx;
    out[a + 1] = cy - hy;
    out[a + 2] = cz - hz;
    out[b] = cx + hx;
    out[b + 1] = cy + hy;
    out[b + 2] = cz + hz;
  }
}

void slope(const Scene *s, const double *x, const double *u, const double *taut, double *xdot) {
  const int half = 3 * s->nodes;
  memcpy(xdot, x + half, half * sizeof(double));
  pull(s, x, u, taut, s->force);
  accelerate(s, x, x + half, s->force, xdot + half);
}

static double now(void) {
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return t.tv_sec + 1e-9 * t.tv_nsec;
}

/* Seconds of one evaluation of the yardstick, over so many. */
double time_yardstick(const Scene *s, const double *x, const double *u, const double *taut, double *xdot,
                      int repeats) {
  const double began = now();
  for (int i = 0; i < repeats; ++i) slope(s, x, u, taut, xdot);
  return (now() - began) / repeats;
}

/* The same for the slope of the compiled core, by its records of a scene and of its inputs. */
double time_core(void (*function)(const void *, const void *, const double *, const double *, double *,
                                  double *),
                 const void *scene, const void *drive, const double *x, const double *taut, double *xdot,
                 double *work, int repeats) {
  const double began = now();
  for (int i = 0; i < repeats; ++i) function(scene, drive, x, taut, xdot, work);
  return (now() - began) / repeats;
}
