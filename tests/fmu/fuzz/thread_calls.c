/* Many instances of an FMU in many threads: each gives what it gives alone. ThreadSanitizer watches.
 *
 *     thread_calls THREADS INSTANCES    (of each thread, one after the other)
 */
#define _POSIX_C_SOURCE 200809L
#include <math.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi3Functions.h"
#include "fmu_core.h"

enum { MOST_THREADS = 64, STEPS = 30 };

static int instances;

static void require(int ok, const char *what)
{
    if (ok)
        return;
    fprintf(stderr, "%s\n", what);
    exit(1);
}

/* Steps, refusals, a saved state and a derivative; the outputs depend on the seed. */
static double run(int seed)
{
    const fmi3ValueReference input = FIRST_INPUT, output = FIRST_OUTPUT, absent = N_VARIABLES;
    fmi3Boolean event, end, early;
    double last_s, tip = 0.0, slope = 0.0, one = 1.0, sum = 0.0;
    fmi3FMUState saved = NULL;
    fmi3Instance fmu = fmi3InstantiateCoSimulation("thread", FMU_TOKEN, NULL, 0, 0, 0, 0, NULL, 0,
                                                   NULL, NULL, NULL);
    require(fmu && fmi3EnterInitializationMode(fmu, 0, 0.0, 0.0, 0, 0.0) == fmi3OK &&
                fmi3ExitInitializationMode(fmu) == fmi3OK, "start");
    for (int k = 0; k < STEPS; k++) {
        double value = 0.1 * seed * sin(0.1 * k);
        require(fmi3SetFloat64(fmu, &input, 1, &value, 1) == fmi3OK, "set");
        require(fmi3SetFloat64(fmu, &absent, 1, &value, 1) == fmi3Error, "refusal");
        require(fmi3DoStep(fmu, k * SAMPLE_S, SAMPLE_S, 1, &event, &end, &early, &last_s) == fmi3OK,
                "step");
        require(fmi3GetFloat64(fmu, &output, 1, &tip, 1) == fmi3OK, "get");
        require(fmi3GetDirectionalDerivative(fmu, &output, 1, &input, 1, &one, 1, &slope, 1) ==
                    fmi3OK, "derivative");
        sum += tip + slope;
    }
    require(fmi3GetFMUState(fmu, &saved) == fmi3OK && fmi3SetFMUState(fmu, saved) == fmi3OK &&
                fmi3FreeFMUState(fmu, &saved) == fmi3OK, "state");
    fmi3FreeInstance(fmu);
    return sum;
}

static void *work(void *argument)
{
    int first = *(int *)argument;
    double *sum = calloc((size_t)instances, sizeof *sum);
    require(sum != NULL, "memory");
    for (int i = 0; i < instances; i++)
        sum[i] = run(first + i);
    return sum;
}

int main(int count, char **argument)
{
    static pthread_t thread[MOST_THREADS];
    static int first[MOST_THREADS];
    int threads = count == 3 ? atoi(argument[1]) : 0;
    instances = count == 3 ? atoi(argument[2]) : 0;
    require(threads > 0 && threads <= MOST_THREADS && instances > 0, "give threads and instances");
    for (int i = 0; i < threads; i++) {
        first[i] = i;
        require(!pthread_create(&thread[i], NULL, work, &first[i]), "a thread");
    }
    for (int i = 0; i < threads; i++) {
        void *result;
        require(!pthread_join(thread[i], &result), "the end of a thread");
        for (int k = 0; k < instances; k++)
            require(((double *)result)[k] == run(i + k), "a thread gives other values");
        free(result);
    }
    printf("%d\n", threads * instances);
    return 0;
}
