/* Derivatives of the model's relations, written out by CasADi: along a direction and adjoint.
 *
 * The relations are the response (outputs, derivatives of the continuous states, event indicators)
 * as a function of states, inputs and parameters; in initialization mode, where the states follow
 * from inputs and parameters, the chain of both. In the event mode a state as unknown is its value
 * after a sample that is taken now, a whole step where all of the model is sampled. The derivative
 * of a sampled output is that of its sample.
 */
#include "fmu_core.h"

#include <math.h>
#include <string.h>

#if WITH_FORWARD

static int check_unknowns(Fmu *fmu, const uint32_t unknown[], size_t count)
{
    int with_states = fmu->memory.mode & (INITIALIZING | EVENT);
    for (size_t i = 0; i < count; i++) {
        if (unknown[i] < FIRST_OUTPUT || unknown[i] >= N_VARIABLES ||
            VARIABLES[unknown[i]].type != FLOAT64)
            return fmu_refuse(fmu, "The value reference %u is no unknown with a derivative.",
                              (unsigned)unknown[i]);
        if (unknown[i] >= FIRST_STATE && unknown[i] < FIRST_DERIVATIVE && !with_states)
            return fmu_refuse(fmu, "%s has a derivative in initialization mode and at samples only.",
                              VARIABLES[unknown[i]].name);
    }
    return 1;
}

static int check_knowns(Fmu *fmu, const uint32_t known[], size_t count)
{
    for (size_t i = 0; i < count; i++) {
        if (known[i] >= FIRST_DERIVATIVE || (known[i] >= FIRST_OUTPUT && known[i] < FIRST_STATE))
            return fmu_refuse(fmu, "The value reference %u is no known.", (unsigned)known[i]);
        if (known[i] >= FIRST_STATE && fmu->memory.mode == INITIALIZING)
            return fmu_refuse(fmu, "%s is no known in initialization mode: it is calculated.",
                              VARIABLES[known[i]].name);
    }
    return 1;
}

static int check(Fmu *fmu, const uint32_t unknown[], size_t unknowns, const uint32_t known[],
                 size_t knowns, const double seed[], size_t seeds)
{
    if (!check_unknowns(fmu, unknown, unknowns) || !check_knowns(fmu, known, knowns))
        return 0;
    if (!fmu_all_finite(seed, seeds))
        return fmu_refuse(fmu, "A seed is not a finite number.");
    return fmu->memory.mode != INITIALIZING || fmu_refresh(fmu);
}

/* Place of a known among states, inputs and parameters; the time, 0, has none. */
static int place_of(uint32_t known)
{
    return known >= FIRST_STATE ? (int)(known - FIRST_STATE) : N_STATES - FIRST_INPUT + (int)known;
}

static int is_state(uint32_t reference)
{
    return reference >= FIRST_STATE && reference < FIRST_DERIVATIVE;
}

/* Place of an unknown among outputs, rates, indicators and states. */
static int row_of(uint32_t unknown)
{
    if (is_state(unknown))
        return N_RESPONSE + (int)(unknown - FIRST_STATE);
    return (int)(unknown - FIRST_OUTPUT) - (unknown >= FIRST_DERIVATIVE ? N_STATES : 0);
}

static size_t count_states(const uint32_t unknown[], size_t count)
{
    size_t states = 0;
    for (size_t i = 0; i < count; i++)
        states += is_state(unknown[i]);
    return states;
}

/* Call a derivative with (x, u, p, seed); that of the initial state has no x. */
static void differentiate(Fmu *fmu, Model *model, int with_state, const double *seed, double *out)
{
    const double *first[] = {fmu->memory.state, fmu->memory.value + FIRST_INPUT,
                             fmu->memory.value + FIRST_PARAMETER, seed};
    memcpy(fmu->argument, first + !with_state, (3 + with_state) * sizeof *first);
    fmu->result[0] = out;
    model(fmu->argument, fmu->result, fmu->integers, fmu->reals, 0);
}

int fmu_forward(Fmu *fmu, const uint32_t unknown[], size_t unknowns, const uint32_t known[],
                size_t knowns, const double seed[], double sensitivity[])
{
    double *of_states = fmu->slope + N_RESPONSE;
    if (!check(fmu, unknown, unknowns, known, knowns, seed, knowns))
        return 0;
    size_t states = count_states(unknown, unknowns);
    memset(fmu->direction, 0, sizeof fmu->direction);
    for (size_t i = 0; i < knowns; i++)
        if (known[i])
            fmu->direction[place_of(known[i])] += seed[i];
    if (fmu->memory.mode == INITIALIZING) {
        differentiate(fmu, model_initial_forward, 0, fmu->direction + N_STATES, of_states);
        memcpy(fmu->direction, of_states, N_STATES * sizeof *of_states);
    } else if (states) {
        differentiate(fmu, model_sample_forward, 1, fmu->direction, of_states);
    }
    if (states < unknowns)
        differentiate(fmu, model_response_forward, 1, fmu->direction, fmu->slope);
    for (size_t i = 0; i < unknowns; i++)
        if (!isfinite(fmu->slope[row_of(unknown[i])]))
            return fmu_refuse(fmu, "A derivative of %s is not a finite number.",
                              VARIABLES[unknown[i]].name);
    for (size_t i = 0; i < unknowns; i++)
        sensitivity[i] = fmu->slope[row_of(unknown[i])];
    return 1;
}

#else

int fmu_forward(Fmu *fmu, const uint32_t unknown[], size_t unknowns, const uint32_t known[],
                size_t knowns, const double seed[], double sensitivity[])
{
    return fmu_not_offered(fmu, "The directional derivative");
}

#endif
#if WITH_REVERSE

/* Contribution of one known through the initial state. No adjoint of the initial state is
 * generated: it is needed once per run, and would be a tenth of the FMU's code. */
static double through_start(Fmu *fmu, int place)
{
    double sum = 0.0;
    memset(fmu->gradient, 0, sizeof fmu->gradient);
    fmu->gradient[place] = 1.0;
    differentiate(fmu, model_initial_forward, 0, fmu->gradient + N_STATES, fmu->next);
    for (size_t i = 0; i < N_STATES; i++)
        sum += fmu->next[i] * (fmu->direction[i] + fmu->slope[N_RESPONSE + i]);
    return sum;
}

/* Add the gradient of one weighted relation to the total gradient. */
static void add_gradient(Fmu *fmu, Model *reverse, const double *weight)
{
    differentiate(fmu, reverse, 1, weight, fmu->gradient);
    for (size_t i = 0; i < N_KNOWNS; i++)
        fmu->direction[i] += fmu->gradient[i];
}

int fmu_reverse(Fmu *fmu, const uint32_t unknown[], size_t unknowns, const uint32_t known[],
                size_t knowns, const double seed[], double sensitivity[])
{
    int initial = fmu->memory.mode == INITIALIZING;
    if (!check(fmu, unknown, unknowns, known, knowns, seed, unknowns))
        return 0;
    size_t states = count_states(unknown, unknowns);
    memset(fmu->slope, 0, sizeof fmu->slope);
    memset(fmu->direction, 0, sizeof fmu->direction);
    for (size_t i = 0; i < unknowns; i++)
        fmu->slope[row_of(unknown[i])] += seed[i];
    if (states < unknowns)
        add_gradient(fmu, model_response_reverse, fmu->slope);
    if (states && !initial)
        add_gradient(fmu, model_sample_reverse, fmu->slope + N_RESPONSE);
    for (size_t i = 0; i < knowns; i++) {
        sensitivity[i] = 0.0;
        if (known[i])
            sensitivity[i] = fmu->direction[place_of(known[i])] +
                             (initial ? through_start(fmu, place_of(known[i])) : 0.0);
        if (!isfinite(sensitivity[i]))
            return fmu_refuse(fmu, "A derivative by %s is not a finite number.",
                              VARIABLES[known[i]].name);
    }
    return 1;
}

#else

int fmu_reverse(Fmu *fmu, const uint32_t unknown[], size_t unknowns, const uint32_t known[],
                size_t knowns, const double seed[], double sensitivity[])
{
    return fmu_not_offered(fmu, "The adjoint derivative");
}

#endif
