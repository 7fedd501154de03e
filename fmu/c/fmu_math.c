/* Functions of <math.h> with the same bits on every platform: see fmu_math.h.
 *
 * The algorithms and coefficients are those of fdlibm (docs/sources.md, "FMI"), in operations that
 * IEEE 754 fixes to the last bit; errors are 1 unit in the last place, of tanh 3. Its notice:
 *
 * Copyright (C) 1993 by Sun Microsystems, Inc. All rights reserved.
 * Developed at SunSoft, a Sun Microsystems, Inc. business.
 * Permission to use, copy, modify, and distribute this software is freely granted, provided that
 * this notice is preserved.
 */
#include "fmu_math.h"

#include <stdint.h>
#include <string.h>

#undef sin
#undef cos

#define LENGTH(table) ((int)(sizeof table / sizeof *table))

static double polynomial(const double *coefficient, int count, double x)
{
    double value = coefficient[count - 1];
    for (int i = count - 2; i >= 0; i--)
        value = coefficient[i] + x * value;
    return value;
}

/* ---- Sine and cosine ----------------------------------------------------------------------- */

#define LARGEST_ANGLE 8e5 /* beyond it a C library's own reduction is used */
#define ROUND_BY 6755399441055744.0 /* 1.5 * 2^52: adding it rounds to a whole number */

/* x = n pi/2 + high + low with |high| <= pi/4; returns n. pi/2 is given in three parts. */
static int reduce(double x, double *high, double *low)
{
    double n = x * 6.36619772367581382433e-01 + ROUND_BY - ROUND_BY;
    double first = x - n * 1.57079632673412561417e+00;
    double part = n * 6.07710050630396597660e-11, rest = first - part;
    double tail = n * 2.02226624879595063154e-21 - ((first - rest) - part);
    *high = rest - tail;
    *low = (rest - *high) - tail;
    return (int)n;
}

static double sine(double x, double y)
{
    double z = x * x, w = z * z;
    double r = 8.33333333332248946124e-03 +
               z * (-1.98412698298579493134e-04 + z * 2.75573137070700676789e-06) +
               z * w * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10);
    double v = z * x;
    return x - ((z * (0.5 * y - v * r) - y) - v * -1.66666666666666324348e-01);
}

static double cosine(double x, double y)
{
    double z = x * x, w = z * z, half = 0.5 * z, rest = 1.0 - half;
    double r = z * (4.16666666666666019037e-02 +
                    z * (-1.38888888888741095749e-03 + z * 2.48015872894767294178e-05)) +
               w * w * (-2.75573143513906633035e-07 +
                        z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11));
    return rest + (((1.0 - rest) - half) + (z * r - x * y));
}

static double quadrant(int n, double high, double low)
{
    double value = n & 1 ? cosine(high, low) : sine(high, low);
    return n & 2 ? -value : value;
}

double fmu_sin(double x)
{
    double high, low;
    if (!(fabs(x) < LARGEST_ANGLE))
        return sin(x);
    if (fabs(x) < 1e-9)
        return x;
    int n = reduce(x, &high, &low);
    return quadrant(n, high, low);
}

double fmu_cos(double x)
{
    double high, low;
    if (!(fabs(x) < LARGEST_ANGLE))
        return cos(x);
    int n = reduce(x, &high, &low);
    return quadrant(n + 1, high, low);
}

/* ---- Exponential and hyperbolic tangent ---------------------------------------------------- */

#define LN2_HIGH 6.93147180369123816490e-01
#define LN2_LOW 1.90821492927058770002e-10
#define PER_LN2 1.44269504088896338700e+00

double fmu_exp(double x)
{
    static const double P[] = {1.66666666666666019037e-01, -2.77777777770155933842e-03,
                               6.61375632143793436117e-05, -1.65339022054652515390e-06,
                               4.13813679705723846039e-08};
    if (isnan(x))
        return x;
    if (x > 709.782712893383973096)
        return INFINITY;
    if (x < -745.133219101941108420)
        return 0.0;
    int k = (int)(PER_LN2 * x + (x < 0.0 ? -0.5 : 0.5));
    double high = x - k * LN2_HIGH, low = k * LN2_LOW, r = high - low, square = r * r;
    double c = r - square * polynomial(P, LENGTH(P), square);
    double y = 1.0 + (r * c / (2.0 - c) - low + high), scale;
    if (k < -1000 || k > 1000)
        return ldexp(y, k);
    uint64_t bits = (uint64_t)(1023 + k) << 52;
    memcpy(&scale, &bits, sizeof scale);
    return y * scale;
}

/* exp(x) - 1 for |x| <= 1.2. */
static double exp_less_one(double x)
{
    static const double Q[] = {1.0, -3.33333333333331316428e-02, 1.58730158725481460165e-03,
                               -7.93650757867487942473e-05, 4.00821782732936239552e-06,
                               -2.01099218183624371326e-07};
    int k = 0;
    double c = 0.0;
    if (fabs(x) > 0.5 * LN2_HIGH) {
        k = (int)(PER_LN2 * x + (x < 0.0 ? -0.5 : 0.5));
        double high = x - k * LN2_HIGH, low = k * LN2_LOW;
        x = high - low;
        c = (high - x) - low;
    }
    double half = 0.5 * x, square = x * half, r = polynomial(Q, LENGTH(Q), square);
    double t = 3.0 - r * half, e = square * ((r - t) / (6.0 - x * t));
    if (k == 0)
        return x - (x * e - square);
    e = x * (e - c) - c - square;
    if (k == -1)
        return 0.5 * (x - e) - 0.5;
    if (k == 1)
        return x < -0.25 ? -2.0 * (e - (x + 0.5)) : 1.0 + 2.0 * (x - e);
    return k > 0 ? (x - e + 0.75) * 4.0 : (x - e + 1.0) * 0.25 - 1.0;
}

double fmu_tanh(double x)
{
    double size = fabs(x), y, t;
    if (isnan(x) || size < 1e-9)
        return x;
    if (size > 22.0)
        y = 1.0;
    else if (size > 0.5493061443340549)
        y = 1.0 - 2.0 / (fmu_exp(2.0 * size) + 1.0);
    else if (size > 0.25541281188299536) {
        t = exp_less_one(2.0 * size);
        y = t / (t + 2.0);
    } else {
        t = exp_less_one(-2.0 * size);
        y = -t / (t + 2.0);
    }
    return x < 0.0 ? -y : y;
}

/* ---- Error function ------------------------------------------------------------------------ */

static const double ERF_P[] = {
    1.28379167095512558561e-01, -3.25042107247001499370e-01, -2.84817495755985104766e-02,
    -5.77027029648944159157e-03, -2.37630166566501626084e-05,
};
static const double ERF_Q[] = {
    1.0, 3.97917223959155352819e-01, 6.50222499887672944485e-02, 5.08130628187576562776e-03,
    1.32494738004321644526e-04, -3.96022827877536812320e-06,
};
static const double ERF_PA[] = {
    -2.36211856075265944077e-03, 4.14856118683748331666e-01, -3.72207876035701323847e-01,
    3.18346619901161753674e-01, -1.10894694282396677476e-01, 3.54783043256182359371e-02,
    -2.16637559486879084300e-03,
};
static const double ERF_QA[] = {
    1.0, 1.06420880400844228286e-01, 5.40397917702171048937e-01, 7.18286544141962662868e-02,
    1.26171219808761642112e-01, 1.36370839120290507362e-02, 1.19844998467991074170e-02,
};
static const double ERF_RA[] = {
    -9.86494403484714822705e-03, -6.93858572707181764372e-01, -1.05586262253232909814e+01,
    -6.23753324503260060396e+01, -1.62396669462573470355e+02, -1.84605092906711035994e+02,
    -8.12874355063065934246e+01, -9.81432934416914548592e+00,
};
static const double ERF_SA[] = {
    1.0, 1.96512716674392571292e+01, 1.37657754143519042600e+02, 4.34565877475229228821e+02,
    6.45387271733267880336e+02, 4.29008140027567833386e+02, 1.08635005541779435134e+02,
    6.57024977031928170135e+00, -6.04244152148580987438e-02,
};
static const double ERF_RB[] = {
    -9.86494292470009928597e-03, -7.99283237680523006574e-01, -1.77579549177547519889e+01,
    -1.60636384855821916062e+02, -6.37566443368389627722e+02, -1.02509513161107724954e+03,
    -4.83519191608651397019e+02,
};
static const double ERF_SB[] = {
    1.0, 3.03380607434824582924e+01, 3.25792512996573918826e+02, 1.53672958608443695994e+03,
    3.19985821950859553908e+03, 2.55305040643316442583e+03, 4.74528541206955367215e+02,
    -2.24409524465858183362e+01,
};

static double ratio(const double *p, int np, const double *q, int nq, double x)
{
    return polynomial(p, np, x) / polynomial(q, nq, x);
}

#define RATIO(P, Q, x) ratio(P, LENGTH(P), Q, LENGTH(Q), x)

double fmu_erf(double x)
{
    double size = fabs(x), y;
    if (isnan(x))
        return x;
    if (size < 0.84375)
        return size < 3e-9 ? 0.125 * (8.0 * x + 1.02703333676410069053e+00 * x)
                           : x + x * RATIO(ERF_P, ERF_Q, x * x);
    if (size < 1.25)
        y = 8.45062911510467529297e-01 + RATIO(ERF_PA, ERF_QA, size - 1.0);
    else if (size < 6.0) {
        double s = 1.0 / (size * size), high = size;
        double r = size < 2.857142857142857 ? RATIO(ERF_RA, ERF_SA, s) : RATIO(ERF_RB, ERF_SB, s);
        uint64_t bits;
        memcpy(&bits, &high, sizeof bits); /* the upper half of the digits */
        bits &= UINT64_C(0xffffffff00000000);
        memcpy(&high, &bits, sizeof high);
        y = 1.0 - fmu_exp(-high * high - 0.5625) *
                      fmu_exp((high - size) * (high + size) + r) / size;
    } else
        y = 1.0;
    return x < 0.0 ? -y : y;
}
