// Lanes of runs in vectors, for the generated kernels: GCC vector extensions and, on x86, the
// intrinsics for what these lack. Before this file REAL is defined as float or double.
//
// vec: reals; ints: integers of the same size (any integer kind); mask: one truth value a lane.
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <type_traits>
#if defined(__x86_64__)
#include <immintrin.h>
#endif
#if defined(__AVX512F__) && defined(__AVX512DQ__) && defined(__AVX512VL__)
#define WIDE 1
#define BYTES 64
#elif defined(__AVX__)
#define BYTES 32
#else
#define BYTES 16
#endif

using real = REAL;
constexpr bool SINGLE = std::is_same_v<real, float>;
using whole = std::conditional_t<SINGLE, int32_t, int64_t>;
using natural = std::make_unsigned_t<whole>;
typedef real vec __attribute__((vector_size(BYTES)));
typedef whole ints __attribute__((vector_size(BYTES)));
typedef natural bits __attribute__((vector_size(BYTES)));
constexpr int LANES = BYTES / sizeof(real);
#define INLINE static inline __attribute__((always_inline, unused))
#define BY_TYPE(single, two) \
  if constexpr (SINGLE) return single; else return two

INLINE vec all(real x) { return vec{} + x; }
INLINE ints same(whole x) { return ints{} + x; }
INLINE vec load(const real* p) { vec r; memcpy(&r, p, sizeof r); return r; }
INLINE void store(real* p, vec x) { memcpy(p, &x, sizeof x); }
INLINE ints load_ints(const int32_t* p) {
  typedef int32_t half __attribute__((vector_size(LANES * 4)));
  half r;
  memcpy(&r, p, sizeof r);
  return __builtin_convertvector(r, ints);
}
INLINE void store_ints(int32_t* p, ints x) {
  typedef int32_t half __attribute__((vector_size(LANES * 4)));
  half r = __builtin_convertvector(x, half);
  memcpy(p, &r, sizeof r);
}

// --- comparisons and selections ---------------------------------------------------------------
#if WIDE
using mask = std::conditional_t<SINGLE, __mmask16, __mmask8>;
#define COMPARE(name, real_code, int_code)                                                   \
  INLINE mask name(vec x, vec y) {                                                           \
    BY_TYPE(_mm512_cmp_ps_mask((__m512)x, (__m512)y, real_code),                             \
            _mm512_cmp_pd_mask((__m512d)x, (__m512d)y, real_code));                          \
  }                                                                                          \
  INLINE mask name(ints x, ints y) {                                                         \
    BY_TYPE(_mm512_cmp_epi32_mask((__m512i)x, (__m512i)y, int_code),                         \
            _mm512_cmp_epi64_mask((__m512i)x, (__m512i)y, int_code));                        \
  }
COMPARE(eq, _CMP_EQ_OQ, _MM_CMPINT_EQ) COMPARE(ne, _CMP_NEQ_UQ, _MM_CMPINT_NE)
COMPARE(lt, _CMP_LT_OQ, _MM_CMPINT_LT) COMPARE(le, _CMP_LE_OQ, _MM_CMPINT_LE)
COMPARE(gt, _CMP_GT_OQ, _MM_CMPINT_NLE) COMPARE(ge, _CMP_GE_OQ, _MM_CMPINT_NLT)
INLINE vec pick(mask m, vec yes, vec no) {
  BY_TYPE((vec)_mm512_mask_blend_ps(m, (__m512)no, (__m512)yes),
          (vec)_mm512_mask_blend_pd(m, (__m512d)no, (__m512d)yes));
}
INLINE ints pick(mask m, ints yes, ints no) {
  BY_TYPE((ints)_mm512_mask_blend_epi32(m, (__m512i)no, (__m512i)yes),
          (ints)_mm512_mask_blend_epi64(m, (__m512i)no, (__m512i)yes));
}
INLINE mask both(mask a, mask b) { return a & b; }
INLINE mask either(mask a, mask b) { return a | b; }
INLINE mask differ(mask a, mask b) { return a ^ b; }
INLINE mask none(mask a) { return ~a; }
INLINE mask every(bool x) { return x ? (mask)-1 : (mask)0; }
INLINE bool everywhere(mask m) { return m == (mask)-1; }
INLINE bool at_lane(mask m, int lane) { return m >> lane & 1; }
INLINE mask finite(vec x) {
  BY_TYPE((mask)~_mm512_fpclass_ps_mask((__m512)x, 0x99),
          (mask)~_mm512_fpclass_pd_mask((__m512d)x, 0x99));
}
#else
using mask = ints;
#define COMPARE(name, sign)                                       \
  INLINE mask name(vec x, vec y) { return (ints)(x sign y); }     \
  INLINE mask name(ints x, ints y) { return (ints)(x sign y); }
COMPARE(eq, ==) COMPARE(ne, !=) COMPARE(lt, <) COMPARE(le, <=) COMPARE(gt, >) COMPARE(ge, >=)
INLINE vec pick(mask m, vec yes, vec no) { return (vec)((m & (ints)yes) | (~m & (ints)no)); }
INLINE ints pick(mask m, ints yes, ints no) { return (m & yes) | (~m & no); }
INLINE mask both(mask a, mask b) { return a & b; }
INLINE mask either(mask a, mask b) { return a | b; }
INLINE mask differ(mask a, mask b) { return a ^ b; }
INLINE mask none(mask a) { return ~a; }
INLINE mask every(bool x) { return same(x ? -1 : 0); }
INLINE bool everywhere(mask m) {
  whole r = -1;
  for (int i = 0; i < LANES; i++) r &= m[i];
  return r != 0;
}
INLINE bool at_lane(mask m, int lane) { return m[lane] != 0; }
INLINE mask finite(vec x) {
  constexpr whole top = SINGLE ? 0x7f800000 : (whole)0x7ff0000000000000LL;
  return ((ints)x & top) != top;
}
#endif
INLINE mask pick(mask m, mask yes, mask no, int) { return either(both(m, yes), both(none(m), no)); }
INLINE ints as_ints(mask m) { return pick(m, same(1), same(0)); }
INLINE vec as_real(mask m) { return pick(m, all(1), all(0)); }
INLINE mask as_mask(ints x) { return ne(x, same(0)); }
INLINE mask below(ints x, ints y) {  // unsigned
  constexpr whole top = std::is_same_v<whole, int32_t> ? INT32_MIN : 0;
  return lt(x ^ top, y ^ top);
}

// --- arithmetic that the extensions lack ------------------------------------------------------
#define LOOP(name, f) \
  INLINE vec name(vec x) { vec r; for (int i = 0; i < LANES; i++) r[i] = f(x[i]); return r; }
// smaller, larger: the second operand where either is NaN
#if WIDE
INLINE vec larger(vec a, vec b) {
  BY_TYPE((vec)_mm512_max_ps((__m512)a, (__m512)b), (vec)_mm512_max_pd((__m512d)a, (__m512d)b));
}
INLINE vec smaller(vec a, vec b) {
  BY_TYPE((vec)_mm512_min_ps((__m512)a, (__m512)b), (vec)_mm512_min_pd((__m512d)a, (__m512d)b));
}
INLINE vec root(vec x) {
  BY_TYPE((vec)_mm512_sqrt_ps((__m512)x), (vec)_mm512_sqrt_pd((__m512d)x));
}
#define ROUND(name, code)                                   \
  INLINE vec name(vec x) {                                  \
    BY_TYPE((vec)_mm512_roundscale_ps((__m512)x, code),     \
            (vec)_mm512_roundscale_pd((__m512d)x, code));   \
  }
ROUND(floored, 9) ROUND(ceiled, 10) ROUND(rounded, 8)
#elif BYTES == 32
INLINE vec larger(vec a, vec b) {
  BY_TYPE((vec)_mm256_max_ps((__m256)a, (__m256)b), (vec)_mm256_max_pd((__m256d)a, (__m256d)b));
}
INLINE vec smaller(vec a, vec b) {
  BY_TYPE((vec)_mm256_min_ps((__m256)a, (__m256)b), (vec)_mm256_min_pd((__m256d)a, (__m256d)b));
}
INLINE vec root(vec x) {
  BY_TYPE((vec)_mm256_sqrt_ps((__m256)x), (vec)_mm256_sqrt_pd((__m256d)x));
}
#define ROUND(name, code)                                   \
  INLINE vec name(vec x) {                                  \
    BY_TYPE((vec)_mm256_round_ps((__m256)x, code),          \
            (vec)_mm256_round_pd((__m256d)x, code));        \
  }
ROUND(floored, 9) ROUND(ceiled, 10) ROUND(rounded, 8)
#else
INLINE vec larger(vec a, vec b) { return pick(gt(a, b), a, b); }
INLINE vec smaller(vec a, vec b) { return pick(lt(a, b), a, b); }
LOOP(root, std::sqrt) LOOP(floored, std::floor) LOOP(ceiled, std::ceil) LOOP(rounded, std::rint)
#endif
INLINE vec larger_or_nan(vec a, vec b) { return pick(ne(a, a), a, larger(a, b)); }
INLINE vec smaller_or_nan(vec a, vec b) { return pick(ne(a, a), a, smaller(a, b)); }
INLINE ints larger(ints a, ints b) { return pick(gt(a, b), a, b); }
INLINE ints smaller(ints a, ints b) { return pick(lt(a, b), a, b); }
constexpr whole SIGN = SINGLE ? (whole)INT32_MIN : (whole)INT64_MIN;
INLINE vec magnitude(vec x) { return (vec)((ints)x & ~SIGN); }
INLINE vec with_sign(vec x, vec s) { return (vec)(((ints)x & ~SIGN) | ((ints)s & SIGN)); }
INLINE ints magnitude(ints x) { return pick(lt(x, same(0)), -x, x); }
INLINE vec sign(vec x) { return pick(gt(x, all(0)), all(1), pick(lt(x, all(0)), all(-1), x)); }
INLINE ints sign(ints x) { return pick(gt(x, same(0)), same(1), pick(lt(x, same(0)), same(-1), x)); }
INLINE vec or_zero(vec x) { return pick(eq(x, x), x, all(0)); }  // in place of NaN
INLINE ints truncated(vec x) { return __builtin_convertvector(x, ints); }
INLINE ints truncated(vec x, real low, real high) {  // saturating; NaN gives 0
  ints r = truncated(smaller(all(high), larger(all(low), x)));
  return pick(eq(x, x), r, same(0));
}
INLINE ints truncated(vec x, real low, real high, whole most) {  // no real is the largest integer
  return pick(gt(x, all(high)), same(most), truncated(x, low, high));
}
INLINE vec to_real(ints x) { return __builtin_convertvector(x, vec); }
INLINE vec to_real_unsigned(ints x) { return __builtin_convertvector((bits)x, vec); }
INLINE ints quotient(ints a, ints b) { return a / b; }
INLINE ints quotient_unsigned(ints a, ints b) { return (ints)((bits)a / (bits)b); }
INLINE ints to_int32(ints x) { return SINGLE ? x : (x << (sizeof(whole) * 8 - 32)) >> (sizeof(whole) * 8 - 32); }
INLINE ints to_uint32(ints x) { return SINGLE ? x : x & (whole)0xffffffffLL; }
INLINE ints shifted_right(ints x, ints by) { return (ints)((bits)x >> (bits)by); }
// by any number, as XLA has it: x / 0 = -1, x % 0 = x, the least number / -1 wraps; bits beyond the
// width are gone
INLINE ints quotient_by_any(ints a, ints b) {
  const mask zero = eq(b, same(0)), minus = eq(b, same(-1));
  const ints negative = (ints)(bits{} - (bits)a);
  return pick(zero, same(-1), pick(minus, negative, a / pick(either(zero, minus), same(1), b)));
}
INLINE ints remainder_by_any(ints a, ints b) {
  const mask zero = eq(b, same(0)), minus = eq(b, same(-1));
  const ints divisor = pick(either(zero, minus), same(1), b);
  return pick(zero, a, a - a / divisor * divisor);
}
INLINE ints quotient_unsigned_by_any(ints a, ints b) {
  const mask zero = eq(b, same(0));
  return pick(zero, to_uint32(same(-1)), quotient_unsigned(a, pick(zero, same(1), b)));
}
INLINE ints shifted_left_by_any(ints x, ints by, whole width) {
  const mask gone = either(lt(by, same(0)), ge(by, same(width)));
  return pick(gone, same(0), (ints)((bits)x << (bits)pick(gone, same(0), by)));
}
INLINE ints shifted_right_by_any(ints x, ints by, whole width) {
  const mask gone = either(lt(by, same(0)), ge(by, same(width)));
  const ints plain = width == 32 ? to_uint32(x) : x;
  return pick(gone, same(0), shifted_right(plain, pick(gone, same(0), by)));
}

// --- elementary functions ---------------------------------------------------------------------
// x = n ln 2 + r with n whole and |r| <= ln 2 / 2; e^r - 1 = r + r^2 q(r), q near-minimax.
struct Reduced { vec r, n; ints power; };  // power: n in the low bits
INLINE Reduced reduced(vec x) {
  constexpr real magic = SINGLE ? 12582912.0 : 6755399441055744.0;
  constexpr real ln2 = SINGLE ? 0.693359375 : 0.693147180369123816490;
  constexpr real rest = SINGLE ? -2.12194440054690583e-4 : 1.90821492927058770002e-10;
  vec shifted = x * (real)1.44269504088896340736 + magic;
  vec n = shifted - magic;
  return {(x - n * ln2) - n * rest, n, (ints)shifted};
}
INLINE vec less_one(vec r) {  // e^r - 1
  vec q;
  if constexpr (SINGLE) {
    q = r * (real)1.3926918e-3f + (real)8.3637670e-3f;
    q = q * r + (real)4.1666550e-2f;
    q = q * r + (real)1.6666573e-1f;
    q = q * r + (real)0.5;
  } else {
    q = r * (real)2.5101335854788522e-08 + (real)2.7621324269313687e-07;
    q = q * r + (real)2.7557266442353424e-06;
    q = q * r + (real)2.4801518672268355e-05;
    q = q * r + (real)1.9841269864364933e-04;
    q = q * r + (real)1.3888888918918907e-03;
    q = q * r + (real)8.3333333333297961e-03;
    q = q * r + (real)4.166666666662068e-02;
    q = q * r + (real)1.6666666666666669e-01;
    q = q * r + (real)0.5;
  }
  return q * (r * r) + r;
}
INLINE vec scaled(vec x, Reduced a) {  // x 2^n for |n| in the range of normal numbers
#if WIDE
  BY_TYPE((vec)_mm512_scalef_ps((__m512)x, (__m512)a.n),
          (vec)_mm512_scalef_pd((__m512d)x, (__m512d)a.n));
#else
  return (vec)((ints)x + (a.power << (SINGLE ? 23 : 52)));
#endif
}
constexpr real EXP_LOW = SINGLE ? -87.3 : -708.3, EXP_HIGH = SINGLE ? 88.72283 : 709.782712893384;
INLINE vec exponential_below(vec x) {  // of x < 88: no overflow
  Reduced a = reduced(larger(all(EXP_LOW), x));
  return scaled(less_one(a.r) + 1, a);
}
INLINE vec exponential(vec x) {
  constexpr real edge = SINGLE ? 88.0 : 709.0;  // 2^n is still a number
  vec y = larger(all(EXP_LOW), x);
  Reduced a = reduced(smaller(all(edge), y));
  vec e = scaled(less_one(a.r) + 1, a);
  vec more = larger(all(0), y - edge);  // up to the overflow: e^edge times 1 + more + more^2 / 2 + ...
  vec near = e * (less_one(smaller(all(1), more)) + 1);
  e = pick(gt(x, all(edge)), near, e);
  e = pick(gt(x, all(EXP_HIGH)), all(INFINITY), e);
  return pick(lt(x, all(EXP_LOW - (real)0.5)), all(0), e);
}
INLINE vec exponential_less_one(vec x) {
  vec y = smaller(all(SINGLE ? 88.0 : 709.0), larger(all(-40), x));
  Reduced a = reduced(y);
  vec power = scaled(all(1), a);
  vec e = less_one(a.r) * power + (power - 1);
  e = pick(eq(x, all(0)), x, e);
  return pick(gt(x, all(EXP_HIGH)), all(INFINITY), e);
}
INLINE vec hyperbolic_tangent(vec x) {
  vec size = smaller(all(SINGLE ? 10 : 20), magnitude(x));  // NaN stays
  Reduced a = reduced(size + size);
  vec power = scaled(all(1), a);
  vec e = less_one(a.r) * power + (power - 1);
  return with_sign(e / (e + 2), x);
}
INLINE vec logistic(vec x) { return 1 / (1 + exponential(-x)); }
INLINE vec inverse_root(vec x) { return 1 / root(x); }

// The other functions: of glibc's vector library where there is one, else lane by lane.
#define SLOW(name, f)                                      \
  static __attribute__((noinline, unused)) vec name(vec x) {       \
    vec r;                                                 \
    for (int i = 0; i < LANES; i++) r[i] = f(x[i]);        \
    return r;                                              \
  }
#define SLOW2(name, f)                                     \
  static __attribute__((noinline, unused)) vec name(vec x, vec y) { \
    vec r;                                                 \
    for (int i = 0; i < LANES; i++) r[i] = f(x[i], y[i]);  \
    return r;                                              \
  }
#if defined(__x86_64__) && defined(__GLIBC__) && BYTES >= 32 && !defined(NO_LIBMVEC)
#if __GLIBC_PREREQ(2, 35)
#define LIBMVEC 1
#endif
#endif
#if LIBMVEC
#if WIDE
#define NAME_S(name) _ZGVeN16v_##name##f
#define NAME_D(name) _ZGVeN8v_##name
typedef __m512 vs; typedef __m512d vd;
#else
#define NAME_S(name) _ZGVdN8v_##name##f
#define NAME_D(name) _ZGVdN4v_##name
typedef __m256 vs; typedef __m256d vd;
#endif
#define VECTOR(name, f)                          \
  extern "C" vs NAME_S(f)(vs);                   \
  extern "C" vd NAME_D(f)(vd);                   \
  INLINE vec name(vec x) { BY_TYPE((vec)NAME_S(f)((vs)x), (vec)NAME_D(f)((vd)x)); }
#else
#define VECTOR(name, f) SLOW(name, std::f)
#endif
VECTOR(f_log, log) VECTOR(f_log1p, log1p) VECTOR(f_sin, sin) VECTOR(f_cos, cos) VECTOR(f_tan, tan)
VECTOR(f_asin, asin) VECTOR(f_acos, acos) VECTOR(f_atan, atan) VECTOR(f_sinh, sinh)
VECTOR(f_cosh, cosh) VECTOR(f_asinh, asinh) VECTOR(f_acosh, acosh) VECTOR(f_atanh, atanh)
VECTOR(f_exp2, exp2) VECTOR(f_cbrt, cbrt) VECTOR(f_erf, erf)
SLOW2(f_pow, std::pow) SLOW2(f_atan2, std::atan2) SLOW2(remainder_of, std::fmod)
INLINE ints remainder_of(ints a, ints b) { return a - a / b * b; }

// --- arrays in memory, read and written at an index a lane ------------------------------------
struct Place { ints index; int64_t first; bool one; };  // one: the same index in every lane
INLINE Place place(ints index) {
  whole first = index[0];
  return {index, first, everywhere(eq(index, same(first)))};
}
INLINE vec look(const real* table, Place at) {  // shared by all lanes
  if (__builtin_expect(at.one, 1)) return all(table[at.first]);
  vec r;
  for (int i = 0; i < LANES; i++) r[i] = table[at.index[i]];
  return r;
}
INLINE ints look(const int32_t* table, Place at) {
  if (__builtin_expect(at.one, 1)) return same(table[at.first]);
  ints r;
  for (int i = 0; i < LANES; i++) r[i] = table[at.index[i]];
  return r;
}
INLINE vec look(const vec* cells, Place at) {  // a lane of its own for each run
  if (__builtin_expect(at.one, 1)) return cells[at.first];
  const real* base = (const real*)cells;
  vec r;
  for (int i = 0; i < LANES; i++) r[i] = base[at.index[i] * LANES + i];
  return r;
}
INLINE void put(vec* cells, Place at, mask where, vec x) {
  if (__builtin_expect(at.one, 1)) {
    cells[at.first] = pick(where, x, cells[at.first]);
    return;
  }
  real* base = (real*)cells;
  for (int i = 0; i < LANES; i++)
    if (at_lane(where, i)) base[at.index[i] * LANES + i] = x[i];
}
