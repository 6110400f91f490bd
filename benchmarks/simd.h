// Vectors of lanes: GCC vector extensions, with a few operations that the extensions lack.
// Compile with -DREAL=float or double and -DBYTES=16, 32 or 64 (width of a vector).
#pragma once
#include <cmath>
#include <cstdint>
#include <cstring>
#include <type_traits>
#if defined(__x86_64__)
#include <immintrin.h>
#endif

using real = REAL;
constexpr bool SINGLE = std::is_same_v<real, float>;
using whole = std::conditional_t<SINGLE, int32_t, int64_t>;
typedef real vec __attribute__((vector_size(BYTES)));
typedef whole ints __attribute__((vector_size(BYTES)));
constexpr int LANES = BYTES / sizeof(real);
#define INLINE static inline __attribute__((always_inline))

INLINE vec all(real x) { return vec{} + x; }
INLINE vec load(const real* p) {
  vec r;
  memcpy(&r, p, sizeof r);
  return r;
}
INLINE void store(real* p, vec x) { memcpy(p, &x, sizeof x); }

// Masks: registers of their own with AVX-512, else vectors of 0 and -1.
#if defined(__AVX512F__) && BYTES == 64
using mask = std::conditional_t<SINGLE, __mmask16, __mmask8>;
#define BY_TYPE(single, two) \
  if constexpr (SINGLE) return single; else return two
INLINE mask at_least(vec x, vec y) {
  BY_TYPE(_mm512_cmp_ps_mask((__m512)x, (__m512)y, _CMP_GE_OQ),
          _mm512_cmp_pd_mask((__m512d)x, (__m512d)y, _CMP_GE_OQ));
}
INLINE vec pick(mask m, vec yes, vec no) {
  BY_TYPE((vec)_mm512_mask_blend_ps(m, (__m512)no, (__m512)yes),
          (vec)_mm512_mask_blend_pd(m, (__m512d)no, (__m512d)yes));
}
INLINE vec add_where(mask m, vec x, vec y) {
  BY_TYPE((vec)_mm512_mask_add_ps((__m512)x, m, (__m512)x, (__m512)y),
          (vec)_mm512_mask_add_pd((__m512d)x, m, (__m512d)x, (__m512d)y));
}
INLINE mask both(mask a, mask b) { return a & b; }
INLINE mask first_only(mask a, mask b) { return a & ~b; }
INLINE mask none_of(mask a) { return ~a; }
INLINE bool any(mask a) { return a != 0; }
INLINE vec larger(vec a, vec b) {
  BY_TYPE((vec)_mm512_max_ps((__m512)a, (__m512)b), (vec)_mm512_max_pd((__m512d)a, (__m512d)b));
}
INLINE vec smaller(vec a, vec b) {
  BY_TYPE((vec)_mm512_min_ps((__m512)a, (__m512)b), (vec)_mm512_min_pd((__m512d)a, (__m512d)b));
}
INLINE vec root(vec x) {
  BY_TYPE((vec)_mm512_sqrt_ps((__m512)x), (vec)_mm512_sqrt_pd((__m512d)x));
}
#else
using mask = ints;
INLINE mask at_least(vec x, vec y) { return x >= y; }
INLINE vec pick(mask m, vec yes, vec no) { return m ? yes : no; }
INLINE vec add_where(mask m, vec x, vec y) { return x + (vec)(m & (ints)y); }
INLINE mask both(mask a, mask b) { return a & b; }
INLINE mask first_only(mask a, mask b) { return a & ~b; }
INLINE mask none_of(mask a) { return ~a; }
#if defined(__AVX2__) && BYTES == 32
#define BY_TYPE(single, two) \
  if constexpr (SINGLE) return single; else return two
INLINE bool any(mask a) { return !_mm256_testz_si256((__m256i)a, (__m256i)a); }
INLINE vec larger(vec a, vec b) {
  BY_TYPE((vec)_mm256_max_ps((__m256)a, (__m256)b), (vec)_mm256_max_pd((__m256d)a, (__m256d)b));
}
INLINE vec smaller(vec a, vec b) {
  BY_TYPE((vec)_mm256_min_ps((__m256)a, (__m256)b), (vec)_mm256_min_pd((__m256d)a, (__m256d)b));
}
INLINE vec root(vec x) {
  BY_TYPE((vec)_mm256_sqrt_ps((__m256)x), (vec)_mm256_sqrt_pd((__m256d)x));
}
#else
INLINE bool any(mask a) {
  whole set = 0;
  for (int i = 0; i < LANES; i++) set |= a[i];
  return set != 0;
}
INLINE vec larger(vec a, vec b) { return a > b ? a : b; }
INLINE vec smaller(vec a, vec b) { return a < b ? a : b; }
INLINE vec root(vec x) {
  vec r;
  for (int i = 0; i < LANES; i++) r[i] = std::sqrt(x[i]);
  return r;
}
#endif
#endif

// e^x = 2^n e^r with n whole (rounded by adding 1.5 * 2^mantissa bits) and |r| <= ln 2 / 2:
// r = x - n ln 2 in two parts, a Taylor polynomial of r, and n added to the exponent's bits.
INLINE vec exponential(vec x) {
  constexpr real low = SINGLE ? -87 : -708, high = SINGLE ? 88 : 709;
  constexpr real magic = SINGLE ? 12582912.0 : 6755399441055744.0;
  constexpr real ln2 = SINGLE ? 0.693359375 : 0.693147180369123816490;
  constexpr real rest = SINGLE ? -2.12194440054690583e-4 : 1.90821492927058770002e-10;
  constexpr int terms = SINGLE ? 6 : 12;
  x = smaller(larger(x, all(low)), all(high));
  vec shifted = x * (real)1.44269504088896340736 + magic;
  vec n = shifted - magic;
  vec r = (x - n * ln2) - n * rest;
  real factor = 1;
  real coefficient[terms + 1];
  for (int i = 0; i <= terms; i++) {
    coefficient[i] = 1 / factor;
    factor *= i + 1;
  }
  vec sum = all(coefficient[terms]);
#pragma GCC unroll 16
  for (int i = terms - 1; i >= 0; i--) sum = sum * r + coefficient[i];
  constexpr int bits = SINGLE ? 23 : 52;
  return (vec)((ints)sum + ((ints)shifted << bits));
}
INLINE vec hyperbolic(vec x) { return 1 - 2 / (exponential(2 * x) + 1); }
