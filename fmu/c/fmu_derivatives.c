/* Derivatives of the model's relations, written out by CasADi: along a direction and adjoint.
 *
 * The relations are the outputs, the derivatives of the continuous states and the event indicators
 * as functions of states, inputs and parameters; in initialization mode, where the states follow
 * from inputs and parameters, the chain of both. In the event mode a state as unknown is its value
 * after a sample that is taken now. The derivative of a sampled output is that of its sample.
 */
#include "fmu_core.h"

#include <math.h>
#include <string.h>

#if WITH_FORWARD

static int check_unknowns(Fmu *fmu, const uint32_t unknown[], size_t count)
{
    int with_states = fmu->memory.mode == INITIALIZING || (fmu->memory.mode == EVENT && !SAMPLED);
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

/* Place of a known in a vector of states, inputs and parameters; the time, 0, has none. */
static int place_of(uint32_t known)
{
    return known >= FIRST_STATE ? (int)(known - FIRST_STATE) : N_STATES - FIRST_INPUT + (int)known;
}

static int any_within(const uint32_t reference[], size_t count, uint32_t first, uint32_t end)
{
    for (size_t i = 0; i < count; i++)
        if (reference[i] >= first && reference[i] < end)
            return 1;
    return 0;
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

/* Where the unknowns of each relation lie, and its derivatives. */
typedef struct {
    uint32_t first, end;
    Model *forward, *reverse;
} Relation;

#if WITH_REVERSE
#define PAIR(name) model_##name##_forward, model_##name##_reverse
#else
#define PAIR(name) model_##name##_forward, NULL
#endif

static const Relation RELATIONS[] = {
    {FIRST_OUTPUT, FIRST_STATE, PAIR(output)},
    {FIRST_DERIVATIVE, FIRST_INDICATOR, PAIR(rate)},
    {FIRST_INDICATOR, N_VARIABLES, PAIR(indicators)},
    {FIRST_STATE, FIRST_DERIVATIVE, PAIR(sample)}, /* in the event mode */
};
enum { N_RELATIONS = sizeof RELATIONS / sizeof *RELATIONS };

int fmu_forward(Fmu *fmu, const uint32_t unknown[], size_t unknowns, const uint32_t known[],
                size_t knowns, const double seed[], double sensitivity[])
{
    int initial = fmu->memory.mode == INITIALIZING;
    if (!check(fmu, unknown, unknowns, known, knowns, seed, knowns))
        return 0;
    memset(fmu->direction, 0, sizeof fmu->direction);
    for (size_t i = 0; i < knowns; i++)
        if (known[i])
            fmu->direction[place_of(known[i])] += seed[i];
    if (initial) {
        differentiate(fmu, model_initial_forward, 0, fmu->direction + N_STATES, fmu->next);
        memcpy(fmu->direction, fmu->next, N_STATES * sizeof *fmu->next);
        memcpy(fmu->slope + FIRST_STATE, fmu->next, N_STATES * sizeof *fmu->next);
    }
    for (int k = 0; k < N_RELATIONS - initial; k++) {
        const Relation *relation = &RELATIONS[k];
        if (any_within(unknown, unknowns, relation->first, relation->end))
            differentiate(fmu, relation->forward, 1, fmu->direction, fmu->slope + relation->first);
    }
    for (size_t i = 0; i < unknowns; i++)
        if (!isfinite(fmu->slope[unknown[i]]))
            return fmu_refuse(fmu, "A derivative of %s is not a finite number.",
                              VARIABLES[unknown[i]].name);
    for (size_t i = 0; i < unknowns; i++)
        sensitivity[i] = fmu->slope[unknown[i]];
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

/* What one known contributes through the start. No adjoint of the start is written: it is needed
 * once a run, and the code would be a tenth of the FMU. */
static double through_start(Fmu *fmu, int place)
{
    double sum = 0.0;
    memset(fmu->gradient, 0, sizeof fmu->gradient);
    fmu->gradient[place] = 1.0;
    differentiate(fmu, model_initial_forward, 0, fmu->gradient + N_STATES, fmu->next);
    for (size_t i = 0; i < N_STATES; i++)
        sum += fmu->next[i] * (fmu->direction[i] + fmu->slope[FIRST_STATE + i]);
    return sum;
}

int fmu_reverse(Fmu *fmu, const uint32_t unknown[], size_t unknowns, const uint32_t known[],
                size_t knowns, const double seed[], double sensitivity[])
{
    int initial = fmu->memory.mode == INITIALIZING;
    if (!check(fmu, unknown, unknowns, known, knowns, seed, unknowns))
        return 0;
    memset(fmu->slope, 0, sizeof fmu->slope);
    memset(fmu->direction, 0, sizeof fmu->direction);
    for (size_t i = 0; i < unknowns; i++)
        fmu->slope[unknown[i]] += seed[i];
    for (int k = 0; k < N_RELATIONS - initial; k++) {
        const Relation *relation = &RELATIONS[k];
        if (!any_within(unknown, unknowns, relation->first, relation->end))
            continue;
        differentiate(fmu, relation->reverse, 1, fmu->slope + relation->first, fmu->gradient);
        for (size_t i = 0; i < N_ALL; i++)
            fmu->direction[i] += fmu->gradient[i];
    }
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
