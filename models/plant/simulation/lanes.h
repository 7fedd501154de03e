/* Arithmetic on N_LANES numbers at once: one lane for each trial that runs in lockstep.
 *
 * Every operation rounds each lane as C does a single double, and functions of the C library are
 * called lane by lane, so a lane holds the bits of a run of its own. Truth is 1 or 0, as in the C
 * code of CasADi, and as there a number that is not one counts as true.
 */
#ifndef LANES_H
#define LANES_H

#include <math.h>

typedef double Real __attribute__((vector_size(N_LANES * sizeof(double))));
typedef long long Mask __attribute__((vector_size(N_LANES * sizeof(double))));

#define casadi_inf INFINITY
#define casadi_nan NAN

#define EACH(number) ((number) - (Real){0}) /* -0 keeps its sign */
#define WHERE(mask, a) ((Real)((mask) & (Mask)(a)))
#define TRUE_WHERE(mask) WHERE(mask, EACH(1.0))

#define LESS(a, b) TRUE_WHERE((a) < (b))
#define LESS_OR_EQUAL(a, b) TRUE_WHERE((a) <= (b))
#define EQUAL(a, b) TRUE_WHERE((a) == (b))
#define UNEQUAL(a, b) TRUE_WHERE((a) != (b))
#define AND(a, b) TRUE_WHERE(((a) != 0.0) & ((b) != 0.0))
#define OR(a, b) TRUE_WHERE(((a) != 0.0) | ((b) != 0.0))
#define NOT(a) TRUE_WHERE((a) == 0.0)
#define ANY(a) (__builtin_reduce_or((Mask)((a) != 0.0)) != 0)
#define IF(a, b) WHERE((a) != 0.0, b)

/* Functions of one number and of two; lanes from `lanes` on are not used. The second form of the
 * former is for a result that is only multiplied by a number, which is often zero. */
#define OF_ONE(function)                                                                 \
    static __attribute__((noinline, unused)) Real lanes_##function(Real x, int lanes) {  \
        for (int i = 0; i < lanes; i++) x[i] = function(x[i]);                           \
        return x;                                                                        \
    }                                                                                    \
    static __attribute__((noinline, unused)) Real lanes_##function##_times(              \
        Real x, Real factor, int lanes) {                                                \
        return ANY(factor) ? lanes_##function(x, lanes) : EACH(0.0);                     \
    }
#define OF_TWO(function)                                                                        \
    static __attribute__((noinline, unused)) Real lanes_##function(Real x, Real y, int lanes) { \
        for (int i = 0; i < lanes; i++) x[i] = function(x[i], y[i]);                            \
        return x;                                                                               \
    }

OF_ONE(sin) OF_ONE(cos) OF_ONE(tan) OF_ONE(asin) OF_ONE(acos) OF_ONE(atan)
OF_ONE(sinh) OF_ONE(cosh) OF_ONE(tanh) OF_ONE(asinh) OF_ONE(acosh) OF_ONE(atanh)
OF_ONE(exp) OF_ONE(log) OF_ONE(expm1) OF_ONE(log1p) OF_ONE(erf) OF_ONE(floor) OF_ONE(ceil)
OF_TWO(pow) OF_TWO(atan2) OF_TWO(fmod) OF_TWO(hypot) OF_TWO(copysign)

/* glibc's sincos, which is not of C99, has the bits of two calls. */
#ifdef __GLIBC__
void sincos(double x, double *sine, double *cosine);
#define SINE_COSINE(x, sine, cosine) sincos(x, sine, cosine)
#else
#define SINE_COSINE(x, sine, cosine) (*(sine) = sin(x), *(cosine) = cos(x))
#endif

static __attribute__((noinline, unused)) void lanes_sincos(Real x, Real *sine, Real *cosine,
                                                           int lanes) {
    Real s = x, c = x;
    for (int i = 0; i < lanes; i++) {
        double own, other;
        SINE_COSINE(x[i], &own, &other);
        s[i] = own, c[i] = other;
    }
    *sine = s, *cosine = c;
}

#define lanes_sqrt(x, lanes) __builtin_elementwise_sqrt(x)
#define lanes_fabs(x, lanes) __builtin_elementwise_abs(x)
#define lanes_fmin(x, y, lanes) __builtin_elementwise_min(x, y)
#define lanes_fmax(x, y, lanes) __builtin_elementwise_max(x, y)
#define lanes_sq(x, lanes) ((x) * (x))

static inline __attribute__((unused)) Real lanes_sign(Real x, int lanes) {
    (void)lanes;
    const Mask below = x < 0.0, above = x > 0.0;
    return (Real)((below & (Mask)EACH(-1.0)) | (above & (Mask)EACH(1.0)) |
                  (~below & ~above & (Mask)x));
}

#endif
