/* Model Exchange: the host integrates the continuous states, samples are taken at time events.
 *
 * A model is sampled every SAMPLE_S from the start on. If it has continuous states, a sample runs
 * the discrete updates of the model, the inputs being those of that time (the staircase of the
 * goals). If it has none (SAMPLED), all of it runs at the samples: a whole step of the model, the
 * inputs being those at its end. Outputs that are sampled change at these events only.
 */
#include "fmu_core.h"

#include <math.h>
#include <string.h>

static double next_sample_s(const Memory *memory)
{
    return memory->start_s + memory->samples * SAMPLE_S;
}

static double tolerance_s(double time_s) { return TIME_TOLERANCE * (SAMPLE_S + fabs(time_s)); }

static int check_stop(Fmu *fmu)
{
    double time_s = fmu->memory.value[0], stop_s = fmu->memory.stop_s;
    if (time_s <= stop_s + 1e-6 * SAMPLE_S + tolerance_s(stop_s))
        return 1;
    return fmu_refuse(fmu, "The time of %.9g s is beyond the stop time of %.9g s.", time_s, stop_s);
}

int fmu_enter_event_mode(Fmu *fmu)
{
    if (!check_stop(fmu))
        return 0;
    fmu->memory.mode = EVENT;
    return 1;
}

int fmu_enter_continuous_time(Fmu *fmu)
{
    fmu->memory.mode = CONTINUOUS;
    return 1;
}

/* A completed step of the integrator never causes an event, but it may exceed the stop time. */
int fmu_complete_step(Fmu *fmu) { return check_stop(fmu); }

/* Publish the samples of this time and take those of the inputs. */
static int sample(Fmu *fmu)
{
    Memory *memory = &fmu->memory;
    if (memory->samples > 0.0) {
        if (SAMPLED)
            fmu_advance_step(fmu, SAMPLE_S);
        else
            fmu_advance(fmu, model_finish, SAMPLE_S);
    }
    fmu_evaluate(fmu, model_output, memory->state, 0.0, fmu->outputs);
    if (!fmu_all_finite(fmu->outputs, N_OUTPUTS))
        return 0;
    memcpy(memory->value + FIRST_OUTPUT, fmu->outputs, sizeof fmu->outputs[0] * N_OUTPUTS);
    if (!SAMPLED)
        fmu_advance(fmu, model_begin, SAMPLE_S);
    return fmu_all_finite(memory->state, N_STATES);
}

int fmu_update(Fmu *fmu, Update *update)
{
    Memory *memory = &fmu->memory, before = *memory;
    double time_s = memory->value[0];
    update->states_changed = 0;
    if (time_s >= next_sample_s(memory) - tolerance_s(time_s)) {
        fmu_follow_example(fmu, time_s);
        if (!sample(fmu)) {
            *memory = before;
            return fmu_refuse(fmu, "The sample at %.9g s gave values that are not finite numbers.",
                              time_s);
        }
        double passed = floor((time_s + tolerance_s(time_s) - memory->start_s) / SAMPLE_S);
        memory->samples = MAX(memory->samples, passed) + 1.0;
        memory->stale = STALE;
        for (size_t i = 0; i < N_CONTINUOUS; i++)
            if (memory->state[CONTINUOUS_STATES[i]] != before.state[CONTINUOUS_STATES[i]])
                update->states_changed = 1;
    }
    update->next_s = next_sample_s(memory);
    return 1;
}

/* ---- Time and continuous states ------------------------------------------------------------ */

static int check_count(Fmu *fmu, size_t count, size_t expected, const char *what)
{
    return count == expected || fmu_refuse(fmu, "There are %u %s, not %u.", (unsigned)expected,
                                           what, (unsigned)count);
}

int fmu_set_time(Fmu *fmu, double time_s)
{
    if (!fmu_check_time(fmu, time_s, "time"))
        return 0;
    fmu->memory.value[0] = time_s; /* results depend on the time only through the states */
    return 1;
}

int fmu_set_states(Fmu *fmu, const double state[], size_t count)
{
    if (!check_count(fmu, count, N_CONTINUOUS, "continuous states"))
        return 0;
    if (!fmu_all_finite(state, count))
        return fmu_refuse(fmu, "A continuous state cannot have a value that is not a finite "
                               "number.");
    for (size_t i = 0; i < count; i++)
        fmu->memory.state[CONTINUOUS_STATES[i]] = state[i];
    fmu->memory.stale = STALE;
    return 1;
}

int fmu_get_states(Fmu *fmu, double state[], size_t count)
{
    if (!check_count(fmu, count, N_CONTINUOUS, "continuous states") ||
        (fmu->memory.mode == INITIALIZING && !fmu_refresh(fmu)))
        return 0;
    for (size_t i = 0; i < count; i++)
        state[i] = fmu->memory.state[CONTINUOUS_STATES[i]];
    return 1;
}

int fmu_get_rates(Fmu *fmu, double rate[], size_t count)
{
    int ok = check_count(fmu, count, N_CONTINUOUS, "continuous states");
    if (ok && (ok = fmu_refresh_rates(fmu)) == 1 && count)
        memcpy(rate, fmu->rates, count * sizeof *rate);
    return ok;
}

int fmu_get_indicators(Fmu *fmu, double indicator[], size_t count)
{
    int ok = check_count(fmu, count, N_INDICATORS, "event indicators");
    if (ok && (ok = fmu_refresh_indicators(fmu)) == 1 && count)
        memcpy(indicator, fmu->indicators, count * sizeof *indicator);
    return ok;
}

int fmu_get_nominals(Fmu *fmu, double nominal[], size_t count)
{
    if (!check_count(fmu, count, N_CONTINUOUS, "continuous states"))
        return 0;
    if (count)
        memcpy(nominal, NOMINALS, count * sizeof *nominal);
    return 1;
}
