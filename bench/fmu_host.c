/* Host of an FMU in C, for Co-Simulation in FMI 3.0, with the FMU linked into the program.
 *
 * It measures a step of the FMU, the same step by hand-called functions of CasADi, a directional
 * derivative of all derivatives and outputs, and the time and the resident memory of instances that
 * are made, initialized, stepped, reset and freed. Prints one line of JSON. Argument: instances.
 */
#define _POSIX_C_SOURCE 200809L
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "fmi3Functions.h"
#include "fmu_core.h"

enum { STEPS = 500, ROUNDS = 9 };

static double now_us(void)
{
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return 1e6 * (double)t.tv_sec + 1e-3 * (double)t.tv_nsec;
}

static long resident_kb(void)
{
    long pages = 0, resident = 0;
    FILE *file = fopen("/proc/self/statm", "r");
    if (!file || fscanf(file, "%ld %ld", &pages, &resident) != 2)
        resident = 0;
    if (file)
        fclose(file);
    return resident * (sysconf(_SC_PAGESIZE) / 1024);
}

static double goal(int k) { return 0.5 * sin(0.0245 * k); }

static fmi3Instance ready(void)
{
    fmi3Instance instance = fmi3InstantiateCoSimulation("bench", FMU_TOKEN, NULL, 0, 0, 0, 0, NULL, 0,
                                                        NULL, NULL, NULL);
    if (!instance || fmi3EnterInitializationMode(instance, 0, 0.0, 0.0, 0, 0.0) != fmi3OK ||
        fmi3ExitInitializationMode(instance) != fmi3OK)
        exit(1);
    return instance;
}

static void step(fmi3Instance instance, int k)
{
    fmi3Boolean event, end, early;
    double last_s;
    if (fmi3DoStep(instance, k * SAMPLE_S, SAMPLE_S, 1, &event, &end, &early, &last_s) != fmi3OK)
        exit(1);
}

static double step_by_fmu(double *tip)
{
    fmi3Instance instance = ready();
    const fmi3ValueReference first = FIRST_INPUT, out = FIRST_STATE - 1;
    double begin_us = now_us();
    for (int k = 0; k < STEPS; k++) {
        double value = goal(k);
        fmi3SetFloat64(instance, &first, 1, &value, 1);
        step(instance, k);
        fmi3GetFloat64(instance, &out, 1, tip, 1);
    }
    double us = (now_us() - begin_us) / STEPS;
    fmi3FreeInstance(instance);
    return us;
}

/* What somebody writes who calls the functions of CasADi without an FMU. */
static double step_by_hand(double *tip)
{
    static const double *argument[WORK_ARGUMENTS];
    static double *result[WORK_RESULTS], reals[WORK_REALS];
    static casadi_int integers[WORK_INTEGERS];
    static double x[N_STATES], next[N_STATES], u[N_INPUTS], p[ROOM(N_PARAMETERS)], y[N_OUTPUTS], h;
    static Model *const PARTS[] = {model_begin, model_flow, model_finish};
    int count = (int)ceil(SAMPLE_S / MAX_SUBSTEP_S - 1e-9);
    for (int i = 0; i < N_INPUTS; i++)
        u[i] = VARIABLES[FIRST_INPUT + i].start;
    for (int i = 0; i < N_PARAMETERS; i++)
        p[i] = VARIABLES[FIRST_PARAMETER + i].start;
    argument[0] = u, argument[1] = p, result[0] = x;
    model_initial(argument, result, integers, reals, 0);
    double begin_us = now_us();
    for (int k = 0; k < STEPS; k++) {
        u[0] = goal(k);
        for (int part = 0; part < count + 2; part++) {
            int kind = part == 0 ? 0 : part <= count ? 1 : 2;
            h = kind == 1 ? SAMPLE_S / count : SAMPLE_S;
            argument[0] = x, argument[1] = u, argument[2] = p, argument[3] = &h, result[0] = next;
            PARTS[kind](argument, result, integers, reals, 0);
            memcpy(x, next, sizeof x);
        }
        argument[0] = x, argument[1] = u, argument[2] = p, result[0] = y;
        model_output(argument, result, integers, reals, 0);
    }
    *tip = y[N_OUTPUTS - 1];
    return (now_us() - begin_us) / STEPS;
}

static double derivative(int adjoint)
{
    fmi3Instance instance = ready();
    static fmi3ValueReference unknown[N_VARIABLES], known[N_KNOWNS];
    static double seed[N_VARIABLES], slope[N_VARIABLES];
    size_t unknowns = 0, knowns = 0;
    for (uint32_t r = FIRST_OUTPUT; r < FIRST_INDICATOR; r++)
        if (VARIABLES[r].type == FLOAT64 && (r < FIRST_STATE || r >= FIRST_DERIVATIVE))
            unknown[unknowns++] = r;
    for (uint32_t r = FIRST_INPUT; r < FIRST_OUTPUT; r++)
        known[knowns++] = r;
    for (int i = 0; i < N_CONTINUOUS; i++)
        known[knowns++] = FIRST_STATE + (uint32_t)CONTINUOUS_STATES[i];
    for (size_t i = 0; i < N_VARIABLES; i++)
        seed[i] = 1.0;
    for (int k = 0; k < 20; k++)
        step(instance, k);
    double begin_us = now_us();
    for (int k = 0; k < STEPS; k++) {
        int status = adjoint ? fmi3GetAdjointDerivative(instance, unknown, unknowns, known, knowns,
                                                        seed, unknowns, slope, knowns)
                             : fmi3GetDirectionalDerivative(instance, unknown, unknowns, known,
                                                            knowns, seed, knowns, slope, unknowns);
        if (status != fmi3OK)
            exit(1);
    }
    double us = (now_us() - begin_us) / STEPS;
    fmi3FreeInstance(instance);
    return us;
}

static double instances(int count)
{
    double begin_us = now_us();
    for (int k = 0; k < count; k++) {
        fmi3Instance instance = ready();
        step(instance, 0);
        if (fmi3Reset(instance) != fmi3OK)
            exit(1);
        fmi3FreeInstance(instance);
    }
    return (now_us() - begin_us) / (count ? count : 1);
}

static double least(double best, double value) { return value < best ? value : best; }

int main(int count, char **argument)
{
    int wanted = count > 1 ? atoi(argument[1]) : 1000;
    double tip[2], fmu_us = 1e9, hand_us = 1e9, forward_us = 1e9, adjoint_us = 1e9;
    for (int round = 0; round < ROUNDS; round++) { /* in turn, so that both see the same host */
        fmu_us = least(fmu_us, step_by_fmu(&tip[0]));
        hand_us = least(hand_us, step_by_hand(&tip[1]));
        forward_us = least(forward_us, derivative(0));
        adjoint_us = least(adjoint_us, derivative(1));
    }
    instances(wanted / 10);
    long before_kb = resident_kb();
    double instance_us = instances(wanted);
    printf("{\"step_us\": %.3f, \"by_hand_us\": %.3f, \"step_ratio\": %.4f, \"same\": %s, "
           "\"directional_us\": %.3f, \"directional_ratio\": %.4f, \"adjoint_us\": %.3f, "
           "\"adjoint_ratio\": %.4f, \"instances\": %d, \"instance_us\": %.3f, "
           "\"grown_kb\": %ld, \"instance_bytes\": %u}\n",
           fmu_us, hand_us, fmu_us / hand_us, tip[0] == tip[1] ? "true" : "false", forward_us,
           forward_us / fmu_us, adjoint_us, adjoint_us / fmu_us, wanted, instance_us,
           resident_kb() - before_kb, (unsigned)sizeof(Fmu));
    return 0;
}
