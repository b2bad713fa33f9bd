/*
 * Run the controller on samples from a file.
 *
 * Each line of the standard input is a sample: time, positions, velocities. Each line of the
 * standard output is its answer: status, iterations, command. Words such as nan are numbers here.
 * Leave this file out where the controller goes into a program of its own.
 */
#include <stdio.h>

#include "controller.h"

static int read_numbers(double *values, int count)
{
    int i;
    for (i = 0; i < count; i++)
        if (scanf("%lf", &values[i]) != 1)
            return i == 0 ? 0 : -1;
    return 1;
}

int main(void)
{
    double time, nodes[CONTROLLER_COORDINATES], velocities[CONTROLLER_COORDINATES];
    double command[CONTROLLER_COMMANDS];
    int found, i, status;
    controller_reset();
    while ((found = read_numbers(&time, 1)) == 1) {
        if (read_numbers(nodes, CONTROLLER_COORDINATES) != 1 ||
            read_numbers(velocities, CONTROLLER_COORDINATES) != 1) {
            found = -1;
            break;
        }
        status = controller_command(time, nodes, velocities, command);
        printf("%d %d", status, controller_iterations());
        for (i = 0; i < CONTROLLER_COMMANDS; i++)
            printf(" %.17g", command[i]);
        printf("\n");
    }
    if (found < 0)
        fprintf(stderr, "the last sample is not whole: expected 1 + %d numbers\n",
                2 * CONTROLLER_COORDINATES);
    return found < 0 ? 1 : 0;
}
