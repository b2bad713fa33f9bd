/*
 * Run the controller on samples from a file.
 *
 * Each line of the standard input is a sample: time, positions, velocities. Each line of the
 * standard output is its answer: status, iterations, command. Words such as nan are numbers here;
 * empty lines are passed over. The first line that is not a sample, or an answer that cannot be
 * written, ends the program with a message on the standard error and exit status 1.
 * Leave this file out where the controller goes into a program of its own.
 */
#include <ctype.h>
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "controller.h"

#define NUMBERS (1 + 2 * CONTROLLER_COORDINATES)
#define LONGEST 100 /* letters of a word */

/* Read the next word of a line. Returns its length, 0 at the end of the line, or EOF. */
static int read_word(char *word) {
  int count = 0, c = getchar();
  while (isspace(c) && c != '\n') c = getchar();
  for (; c != EOF && !isspace(c); c = getchar())
    if (count < LONGEST) word[count++] = (char)(isprint(c) ? c : '?');
    else word[0] = '?'; /* no number is so long */
  word[count] = '\0';
  if (count > 0 && c == '\n') ungetc(c, stdin);
  return count > 0 || c == '\n' ? count : EOF;
}

/* Read a number, and return what is wrong with it; NULL if nothing is. */
static const char *read_number(const char *word, double *number) {
  char *end;
  errno = 0;
  *number = strtod(word, &end);
  if (*end != '\0') return "not a number";
  return errno == ERANGE && fabs(*number) > 1.0 ? "out of range" : NULL;
}

static void answer(const double *sample) {
  double command[CONTROLLER_COMMANDS];
  int i, status = controller_command(sample[0], sample + 1, sample + 1 + CONTROLLER_COORDINATES, command);
  printf("%d %d", status, controller_iterations());
  for (i = 0; i < CONTROLLER_COMMANDS; i++) printf(" %.17g", command[i]);
  printf("\n");
}

int main(void) {
  double sample[NUMBERS];
  char word[LONGEST + 1];
  int count = 0, length;
  unsigned long line = 1;
  controller_reset();
  do {
    length = read_word(word);
    if (length > 0) {
      const char *fault = count == NUMBERS ? "too much" : read_number(word, &sample[count]);
      count++;
      if (fault != NULL) {
        fprintf(stderr, "line %lu, word %d: '%.40s' is %s, expected 1 + %d numbers\n", line, count, word,
                fault, NUMBERS - 1);
        return 1;
      }
    } else if (count > 0 && !ferror(stdin)) {
      if (count < NUMBERS) {
        fprintf(stderr, "line %lu ends after %d numbers, expected 1 + %d\n", line, count, NUMBERS - 1);
        return 1;
      }
      answer(sample);
      count = 0;
    }
    line += length == 0;
  } while (length != EOF && !ferror(stdout));
  if (ferror(stdin)) {
    fprintf(stderr, "line %lu: the standard input cannot be read\n", line);
    return 1;
  }
  if (ferror(stdout) || fflush(stdout) != 0) {
    fprintf(stderr, "line %lu: the standard output takes no more\n", line);
    return 1;
  }
  return 0;
}
