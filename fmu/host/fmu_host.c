/* Host of an FMI 3.0 FMU for Co-Simulation in plain C: reads inputs, prints outputs in 17 digits.
 *
 *     fmu_host LIBRARY TOKEN < rows > results
 *
 * It reads no model description. The first line of the rows holds the value references of the
 * inputs, the second those of the outputs, the third the step in s; all further lines hold the
 * inputs of one step. It prints one line of outputs for the start and one after each step. The
 * inputs of the first step are also those of the initialization.
 */
#include "fmi3Functions.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

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

enum { MOST = 256, LONGEST_LINE = 8192 };

static fmi3InstantiateCoSimulationTYPE *instantiate;
static fmi3EnterInitializationModeTYPE *enter_initialization;
static fmi3ExitInitializationModeTYPE *exit_initialization;
static fmi3SetFloat64TYPE *set_float64;
static fmi3GetFloat64TYPE *get_float64;
static fmi3DoStepTYPE *do_step;
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
static void find(Library library, const char *name, void *function)
{
    void *found = (void *)FIND(library, name);
    if (!found)
        fail(name);
    memcpy(function, &found, sizeof found);
}

static void load(const char *path)
{
    Library library = OPEN(path);
    if (!library)
        fail("the library cannot be loaded");
    find(library, "fmi3InstantiateCoSimulation", &instantiate);
    find(library, "fmi3EnterInitializationMode", &enter_initialization);
    find(library, "fmi3ExitInitializationMode", &exit_initialization);
    find(library, "fmi3SetFloat64", &set_float64);
    find(library, "fmi3GetFloat64", &get_float64);
    find(library, "fmi3DoStep", &do_step);
    find(library, "fmi3Terminate", &terminate);
    find(library, "fmi3FreeInstance", &free_instance);
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

static void print_outputs(fmi3Instance fmu, const fmi3ValueReference reference[], int count)
{
    static double value[MOST];
    check(get_float64(fmu, reference, (size_t)count, value, (size_t)count), "fmi3GetFloat64");
    for (int i = 0; i < count; i++)
        printf("%s%.17g", i ? " " : "", value[i]);
    printf("\n");
}

static void log_message(fmi3InstanceEnvironment environment, fmi3Status status,
                        fmi3String category, fmi3String message)
{
    (void)environment, (void)status, (void)category;
    fprintf(stderr, "%s\n", message);
}

int main(int count, char **argument)
{
    static fmi3ValueReference inputs[MOST], outputs[MOST];
    static double step_s[MOST], value[MOST];
    if (count != 3)
        fail("give the library and the instantiation token");
    load(argument[1]);
    fmi3Instance fmu = instantiate("host", argument[2], NULL, fmi3False, fmi3True, fmi3False,
                                   fmi3False, NULL, 0, NULL, log_message, NULL);
    int n_inputs = read_references(inputs), n_outputs = read_references(outputs);
    if (!fmu)
        fail("fmi3InstantiateCoSimulation");
    if (n_inputs < 0 || n_outputs < 1 || read_numbers(step_s) != 1)
        fail("the first three lines are not references, references and a step");
    fmi3Boolean event, stop, early;
    fmi3Float64 time_s = 0.0, reached_s;
    for (int row = 0; read_numbers(value) == n_inputs; row++) {
        check(set_float64(fmu, inputs, (size_t)n_inputs, value, (size_t)n_inputs),
              "fmi3SetFloat64");
        if (row == 0) {
            check(enter_initialization(fmu, fmi3False, 0.0, 0.0, fmi3False, 0.0),
                  "fmi3EnterInitializationMode");
            check(exit_initialization(fmu), "fmi3ExitInitializationMode");
            print_outputs(fmu, outputs, n_outputs);
        }
        check(do_step(fmu, time_s, step_s[0], fmi3True, &event, &stop, &early, &reached_s),
              "fmi3DoStep");
        time_s += step_s[0];
        print_outputs(fmu, outputs, n_outputs);
    }
    check(terminate(fmu), "fmi3Terminate");
    free_instance(fmu);
    return 0;
}
