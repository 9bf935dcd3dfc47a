/* Recursive least squares with four parameters as a plain C loop: what one update costs without a library, to compare with.
 *
 *   rls TIMES      prints the nanoseconds of one update */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

enum { N = 4, ROWS = 4096 };

static double now_ns(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec * 1e9 + t.tv_nsec;
}

static uint64_t state = 2;

static double uniform(void) {
    state = state * 6364136223846793005u + 1442695040888963407u;
    return (double)(int64_t)state / 9223372036854775808.0;
}

static double theta[N], p[N][N], rows[ROWS][N], values[ROWS];

static double update(const double *x, double value) {
    const double forgetting = 0.98;
    double px[N], denominator = forgetting, innovation = value;
    for (int i = 0; i < N; i++) {
        px[i] = 0;
        for (int k = 0; k < N; k++) px[i] += p[i][k] * x[k];
    }
    for (int i = 0; i < N; i++) denominator += x[i] * px[i], innovation -= x[i] * theta[i];
    for (int i = 0; i < N; i++) theta[i] += px[i] / denominator * innovation;
    /* P is symmetric: its upper half is kept, and written to both. */
    for (int i = 0; i < N; i++)
        for (int k = i; k < N; k++) p[i][k] = p[k][i] = (p[i][k] - px[i] * px[k] / denominator) / forgetting;
    return innovation;
}

int main(int argc, char **argv) {
    const int times = argc > 1 ? atoi(argv[1]) : 1000;
    for (int i = 0; i < N; i++) p[i][i] = 1e6;
    for (int row = 0; row < ROWS; row++) {
        values[row] = 0.1 * uniform();
        for (int i = 0; i < N; i++) values[row] += rows[row][i] = uniform();
    }
    double sum = 0;
    const double begun = now_ns();
    for (int n = 0; n < times; n++)
        for (int row = 0; row < ROWS; row++) sum += update(rows[row], values[row]);
    printf("%.3f\n", (now_ns() - begun) / ((double)times * ROWS));
    /* Without a use of the result the loop would be left out. */
    return sum == 0.123;
}
