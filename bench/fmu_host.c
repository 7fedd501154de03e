/* Host of an FMI 3.0 FMU for Co-Simulation in plain C: reads inputs, prints outputs in 17 digits.
 *
 *     fmu_host LIBRARY TOKEN [ROUNDS] < rows > results
 *
 * It reads no model description. The first line of the rows holds the value references of the
 * inputs, the second those of the outputs, the third the step in s; all further lines hold the
 * inputs of one step. It prints one line of outputs for the start and one after each step. The
 * inputs of the first step are also those of the initialization.
 *
 * With ROUNDS it repeats the run that often, and prints the processor time of a step in µs with
 * setting its inputs and getting its outputs: the mean over the fastest run.
 */
#include "fmi3Functions.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#ifdef _WIN32
#include <windows.h>
#define OPEN(path) LoadLibraryA(path)
#define FIND(library, name) GetProcAddress(library, name)
typedef HMODULE Library;
#else
#include <dlfcn.h>
#define OPEN(path) dlopen(path, RTLD_NOW)
#define FIND(library, name) dlsym(library, name)
typedef void *Library;
#endif

enum { MOST = 256, MOST_ROWS = 1024, LONGEST_LINE = 8192 };

static fmi3InstantiateCoSimulationTYPE *instantiate;
static fmi3EnterInitializationModeTYPE *enter_initialization;
static fmi3ExitInitializationModeTYPE *exit_initialization;
static fmi3SetFloat64TYPE *set_float64;
static fmi3GetFloat64TYPE *get_float64;
static fmi3DoStepTYPE *do_step;
static fmi3ResetTYPE *reset;
static fmi3TerminateTYPE *terminate;
static fmi3FreeInstanceTYPE *free_instance;

static void fail(const char *what)
{
    fprintf(stderr, "fmu_host: %s\n", what);
    exit(2);
}

static void check(fmi3Status status, const char *call)
{
    if (status != fmi3OK)
        fail(call);
}

/* A pointer to an object becomes a pointer to a function, as POSIX and Windows allow. */
static void look_up(Library library, const char *name, void *function)
{
    void *address = (void *)FIND(library, name);
    if (!address)
        fail(name);
    memcpy(function, &address, sizeof address);
}

static void load(const char *path)
{
    Library library = OPEN(path);
    if (!library)
        fail("the library cannot be loaded");
    look_up(library, "fmi3InstantiateCoSimulation", &instantiate);
    look_up(library, "fmi3EnterInitializationMode", &enter_initialization);
    look_up(library, "fmi3ExitInitializationMode", &exit_initialization);
    look_up(library, "fmi3SetFloat64", &set_float64);
    look_up(library, "fmi3GetFloat64", &get_float64);
    look_up(library, "fmi3DoStep", &do_step);
    look_up(library, "fmi3Reset", &reset);
    look_up(library, "fmi3Terminate", &terminate);
    look_up(library, "fmi3FreeInstance", &free_instance);
}

/* Numbers of the next line; -1 at the end of the file. */
static int read_numbers(double number[])
{
    static char line[LONGEST_LINE];
    int count = 0;
    if (!fgets(line, sizeof line, stdin))
        return -1;
    for (char *next = line, *end; count < MOST; next = end) {
        number[count] = strtod(next, &end);
        if (end == next)
            break;
        count++;
    }
    return count;
}

static int read_references(fmi3ValueReference reference[])
{
    static double number[MOST];
    int count = read_numbers(number);
    for (int i = 0; i < count; i++)
        reference[i] = (fmi3ValueReference)number[i];
    return count;
}

static void log_message(fmi3InstanceEnvironment environment, fmi3Status status,
                        fmi3String category, fmi3String message)
{
    (void)environment, (void)status, (void)category;
    fprintf(stderr, "%s\n", message);
}

static fmi3Instance fmu;
static fmi3ValueReference inputs[MOST], outputs[MOST];
static int n_inputs, n_outputs, n_rows;
static double step_s, row[MOST_ROWS][MOST], value[MOST];

static void set_inputs(const double values[])
{
    check(set_float64(fmu, inputs, (size_t)n_inputs, values, (size_t)n_inputs), "fmi3SetFloat64");
}

static void get_outputs(int shown)
{
    check(get_float64(fmu, outputs, (size_t)n_outputs, value, (size_t)n_outputs),
          "fmi3GetFloat64");
    for (int i = 0; shown && i < n_outputs; i++)
        printf("%s%.17g", i ? " " : "", value[i]);
    if (shown)
        printf("\n");
}

/* One run over all rows; the mean processor time of a step in µs. */
static double run(int shown)
{
    fmi3Boolean event, stop, early;
    fmi3Float64 time_s = 0.0, reached_s;
    set_inputs(row[0]);
    check(enter_initialization(fmu, fmi3False, 0.0, 0.0, fmi3False, 0.0),
          "fmi3EnterInitializationMode");
    check(exit_initialization(fmu), "fmi3ExitInitializationMode");
    get_outputs(shown);
    clock_t begin = clock();
    for (int k = 0; k < n_rows; k++) {
        set_inputs(row[k]);
        check(do_step(fmu, time_s, step_s, fmi3True, &event, &stop, &early, &reached_s),
              "fmi3DoStep");
        time_s += step_s;
        get_outputs(shown);
    }
    return 1e6 * (double)(clock() - begin) / CLOCKS_PER_SEC / n_rows;
}

int main(int count, char **argument)
{
    if (count != 3 && count != 4)
        fail("give the library and the instantiation token");
    load(argument[1]);
    fmu = instantiate("host", argument[2], NULL, fmi3False, fmi3True, fmi3False, fmi3False, NULL, 0,
                      NULL, log_message, NULL);
    if (!fmu)
        fail("fmi3InstantiateCoSimulation");
    n_inputs = read_references(inputs), n_outputs = read_references(outputs);
    if (n_inputs < 0 || n_outputs < 1 || read_numbers(value) != 1)
        fail("the first three lines are not references, references and a step");
    step_s = value[0];
    while (n_rows < MOST_ROWS && read_numbers(row[n_rows]) == n_inputs)
        n_rows++;
    if (n_rows == 0)
        fail("there are no rows of inputs");
    run(1);
    double least_us = 1e9;
    for (int round = count == 4 ? atoi(argument[3]) : 0; round > 0; round--) {
        check(reset(fmu), "fmi3Reset");
        double us = run(0);
        least_us = us < least_us ? us : least_us;
    }
    if (count == 4)
        printf("%.3f\n", least_us);
    check(terminate(fmu), "fmi3Terminate");
    free_instance(fmu);
    return 0;
}
