// Two rollouts of the biaxial table by hand, the practical limit on a processor: lanes (runs) in
// SIMD vectors, BLOCK vectors at a time, the time loop inside, all state in registers and L1.
// A row of numbers per parameter and axis, row 2 k + axis, `lanes` long (a multiple of a block).
// No check for lost runs, no record: only the average tracking error (ATE).
#include <thread>
#include <vector>

#include "simd.h"

#ifndef BLOCK
#define BLOCK 1
#endif
#define FOR_BLOCK _Pragma("GCC unroll 8") for (int k = 0; k < BLOCK; k++)
#define FOR_AXES _Pragma("GCC unroll 2") for (int a = 0; a < 2; a++)

constexpr int STEP = LANES * BLOCK;
constexpr int LAYERS = 4, BLOCKS = 3;

struct Job {
  const real *rows, *path;  // path: (ticks, 6) position, velocity, acceleration
  int64_t ticks, lanes;
  real dt;
  real* ate;
};

enum PlantRow { FORCE, MASS, DAMPING, COULOMB, STATIC, STRIBECK, LOAD, PLAY, PLANT_ROWS };
enum CmacRow { SLOPE, RATE, CREDIT, ETA, ERROR_WIDTH, RATE_WIDTH, RATIO, AUTHORITY, CMAC_ROWS };
enum SlidingRow { C1, REACH, WIDTH, GAIN, DRAG, BIAS, SLIDING_ROWS };

INLINE vec row(const Job& job, int64_t lane, int index, int axis) {
  return load(job.rows + (2 * index + axis) * job.lanes + lane);
}

// One axis: current behind a play, position and velocity; the dry friction is implicit, so that it
// sticks exactly.
struct Axis {
  vec position, velocity, current, play, push, load, coulomb, fading, slowness, factor;

  __attribute__((always_inline)) inline void begin(const Job& job, int64_t lane, int first, int a) {
    auto value = [&](int index) { return row(job, lane, first + index, a); };
    vec kick = job.dt / value(MASS);
    position = all(job.path[a]);
    velocity = all(0);
    current = all(0);
    play = value(PLAY);
    push = kick * value(FORCE);
    load = kick * value(LOAD);
    coulomb = kick * value(COULOMB);
    fading = kick * (value(STATIC) - value(COULOMB));
    slowness = 1 / value(STRIBECK);
    factor = 1 / (1 + kick * value(DAMPING));
  }
  __attribute__((always_inline)) inline void step(vec command, real dt) {
    vec share = velocity * slowness;
    current = command - smaller(larger(command - current, -play), play);
    vec free = velocity + push * current - load;
    vec limit = coulomb + fading * exponential(-share * share);
    vec slid = free - smaller(larger(free, -limit), limit);
    velocity = slid * factor;
    position = position + dt * velocity;
  }
};

// Block of every layer that holds z: 0 below l + 1, 2 from l + 5 on, else 1; and z - its centre.
struct Place {
  mask in[LAYERS][BLOCKS];
  vec off[LAYERS];

  __attribute__((always_inline)) inline Place(vec z) {
#pragma GCC unroll 4
    for (int l = 0; l < LAYERS; l++) {
      mask above = at_least(z, all(l + 1)), top = at_least(z, all(l + 5));
      in[l][0] = none_of(above);
      in[l][1] = first_only(above, top);
      in[l][2] = top;
      vec middle = pick(above, all(l + 3), all(l - 1));
      off[l] = z - pick(top, all(l + 7), middle);
    }
  }
};

struct Cmac {
  static constexpr int ROWS = CMAC_ROWS;
  vec slope, learn, switched, per_error, per_rate, narrow;
  vec weights[LAYERS][BLOCKS][BLOCKS];

  __attribute__((always_inline)) inline void begin(const Job& job, int64_t lane, int a) {
    auto value = [&](int index) { return row(job, lane, index, a); };
    slope = value(SLOPE);
    learn = -2 * job.dt * value(RATE) * value(CREDIT) * value(AUTHORITY);
    switched = value(ETA) / value(AUTHORITY);
    per_error = 1 / value(ERROR_WIDTH);
    per_rate = 1 / value(RATE_WIDTH);
    narrow = -value(RATIO) * value(RATIO);
    memset(weights, 0, sizeof weights);
  }
  __attribute__((always_inline)) inline vec command(const Axis&, vec error, vec rate, real) {
    vec surface = -(slope * error + rate);
    vec zero = all(0), nine = all(9);
    Place first(smaller(larger(error * per_error + (real)4.5, zero), nine));
    Place second(smaller(larger(rate * per_rate + (real)4.5, zero), nine));
    vec change = learn * surface;
    vec sum = surface > 0 ? -switched : (surface < 0 ? switched : zero);
#pragma GCC unroll 4
    for (int l = 0; l < LAYERS; l++) {
      vec d1 = first.off[l], d2 = second.off[l];
      vec strength = exponential(narrow * (d1 * d1 + d2 * d2));
      sum = sum + strength * active(weights[l], first.in[l], second.in[l], change * strength);
    }
    return sum;
  }
  // The weight of each lane's active cell, after `change` was added to it.
  __attribute__((always_inline)) static inline vec active(
      vec (&cells)[BLOCKS][BLOCKS], const mask (&one)[BLOCKS], const mask (&two)[BLOCKS],
      vec change) {
    vec found = all(0);
#pragma GCC unroll 3
    for (int i = 0; i < BLOCKS; i++) {
#if SKIP
      if (!any(one[i])) continue;  // rows of cells that no lane of this vector is in
#endif
#pragma GCC unroll 3
      for (int j = 0; j < BLOCKS; j++) {
        mask here = both(one[i], two[j]);
        cells[i][j] = add_where(here, cells[i][j], change);
        found = pick(here, cells[i][j], found);
      }
    }
    return found;
  }
};

struct Sliding {
  static constexpr int ROWS = SLIDING_ROWS;
  vec slope, reach, per_width, drag, bias, per_gain;

  __attribute__((always_inline)) inline void begin(const Job& job, int64_t lane, int a) {
    auto value = [&](int index) { return row(job, lane, index, a); };
    slope = value(C1);
    reach = value(REACH);
    per_width = 1 / value(WIDTH);
    drag = value(DRAG);
    bias = value(BIAS);
    per_gain = 1 / value(GAIN);
  }
  __attribute__((always_inline)) inline vec command(
      const Axis& axis, vec error, vec rate, real acceleration) {
    vec surface = -(slope * error + rate);
    vec known = slope * rate + drag * axis.velocity + bias + acceleration;
    return (known - reach * hyperbolic(surface * per_width)) * per_gain;
  }
};

template <class Law>
static void rollout(const Job& job, int64_t begin, int64_t end) {
  for (int64_t lane = begin; lane < end; lane += STEP) {
    Law law[2][BLOCK];
    Axis axis[2][BLOCK];
    vec ate[BLOCK];
    FOR_BLOCK {
      FOR_AXES {
        law[a][k].begin(job, lane + k * LANES, a);
        axis[a][k].begin(job, lane + k * LANES, Law::ROWS, a);
      }
      ate[k] = all(0);
    }
    for (int64_t t = 0; t < job.ticks; t++) {
      const real* wanted = job.path + 6 * t;
      real weight = (real)1 / (real)(t + 1);
      FOR_BLOCK {
        vec square = all(0), command[2];
        FOR_AXES {
          vec error = wanted[a] - axis[a][k].position;
          vec rate = wanted[2 + a] - axis[a][k].velocity;
          square = square + error * error;
          command[a] = law[a][k].command(axis[a][k], error, rate, wanted[4 + a]);
        }
        FOR_AXES axis[a][k].step(command[a], job.dt);
        ate[k] = ate[k] + (root(square) - ate[k]) * weight;
      }
    }
    FOR_BLOCK store(job.ate + lane + k * LANES, ate[k]);
  }
}

template <class Law>
static void in_threads(const Job& job, int threads) {
  int64_t blocks = job.lanes / STEP;
  std::vector<std::thread> others;
  auto part = [&](int i) { return blocks * i / threads * STEP; };
  for (int i = 1; i < threads; i++) others.emplace_back(rollout<Law>, job, part(i), part(i + 1));
  rollout<Law>(job, part(0), part(1));
  for (auto& thread : others) thread.join();
}

extern "C" int64_t block_lanes() { return STEP; }
extern "C" void run(int law, int threads, const real* rows, const real* path, int64_t ticks,
                    int64_t lanes, double dt, real* ate) {
  Job job{rows, path, ticks, lanes, (real)dt, ate};
  if (law == 0) in_threads<Cmac>(job, threads);
  else in_threads<Sliding>(job, threads);
}
