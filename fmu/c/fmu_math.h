/* Functions of <math.h> with the same bits on every platform, for the generated equations.
 *
 * The C libraries differ in the last digit, and glibc's with the processor. What is not redefined
 * here is exact by IEEE 754 (sqrt, fabs, fmin, floor) or is left to the C library (pow, log, atan).
 */
#ifndef FMU_MATH_H
#define FMU_MATH_H

#include <math.h>

double fmu_sin(double x);
double fmu_cos(double x);
double fmu_exp(double x);
double fmu_tanh(double x);
double fmu_erf(double x);

#define sin fmu_sin
#define cos fmu_cos
#define exp fmu_exp
#define tanh fmu_tanh
#define erf fmu_erf

#endif
