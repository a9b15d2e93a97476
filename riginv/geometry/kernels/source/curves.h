/* Driven-key curves: riginv.geometry.curves.curves_and_derivatives. */

#define WIDTH 32       /* curves that are solved together */
#define ITERATIONS 60  /* of bracketed Newton, at most; typical curves need 4 */
#define NUMBERS 9      /* of a segment: start, width, a, b, c of X, d, e, f, g of Y */

/* Solve ((a t + b) t + c) t = target for WIDTH curves at once, each for t in [0, 1]. */
static void NAME(solve)(const REAL *a, const REAL *b, const REAL *c, const REAL *target, REAL *t) {
    REAL low[WIDTH], high[WIDTH];
    /* Newton's steps converge quadratically: after one this short the next would be below the rounding error. */
    const REAL shortest = (REAL)0.1 * SQRT(EPSILON), exact = 4 * EPSILON;
    for (int k = 0; k < WIDTH; k++) {
        t[k] = target[k];
        low[k] = 0;
        high[k] = 1;
    }
    for (int number = 0; number < ITERATIONS; number++) {
        int moving = 0;
        for (int k = 0; k < WIDTH; k++) {
            REAL error = ((a[k] * t[k] + b[k]) * t[k] + c[k]) * t[k] - target[k];
            REAL derivative = (3 * a[k] * t[k] + 2 * b[k]) * t[k] + c[k];
            high[k] = error > 0 ? t[k] : high[k];
            low[k] = error > 0 ? low[k] : t[k];
            REAL newton = t[k] - error / derivative;
            int inside = (newton >= low[k]) & (newton <= high[k]);
            REAL next = inside ? newton : (low[k] + high[k]) / 2;
            next = FABS(error) <= exact ? t[k] : next;
            moving |= FABS(next - t[k]) > shortest;
            t[k] = next;
        }
        if (!moving) return;
    }
}

/* The value of each curve at its own input, and its derivative there.
 *
 * table (curve, segment, 9); inputs, values and derivatives (batch, curve). derivatives may be NULL.
 */
API int NAME(curves)(const REAL *table, Index curves, Index segments, const REAL *inputs, Index inputs_ld, REAL *values,
                     Index values_ld, REAL *derivatives, Index derivatives_ld, Index batch) {
    Index padded = (curves + WIDTH - 1) / WIDTH * WIDTH;
    /* Number by number, so that what is computed together lies together; the curves' ends come last. */
    REAL *columns = malloc(sizeof(REAL) * (size_t)(padded * (NUMBERS * segments + 1)));
    if (!columns) return 1;
    REAL *ends = columns + padded * NUMBERS * segments;
    for (Index curve = 0; curve < padded; curve++) {
        ends[curve] = curve < curves ? -INFINITY : 1;
        for (Index segment = 0; segment < segments; segment++) {
            for (Index number = 0; number < NUMBERS; number++) {
                REAL filler = number == 1 || number == 4 ? 1 : (REAL)0; /* X(t) = t from 0 to 1 */
                columns[(segment * NUMBERS + number) * padded + curve] =
                    curve < curves ? table[(curve * segments + segment) * NUMBERS + number] : filler;
            }
            if (curve < curves) {
                const REAL *row = table + (curve * segments + segment) * NUMBERS;
                if (!isinf(row[0]) && row[0] + row[1] > ends[curve]) ends[curve] = row[0] + row[1];
            }
        }
    }
    for (Index row = 0; row < batch; row++) {
        for (Index first = 0; first < curves; first += WIDTH) {
            Index count = curves - first < WIDTH ? curves - first : WIDTH;
            REAL given[WIDTH] = {0}, x[WIDTH], part[NUMBERS][WIDTH], target[WIDTH], t[WIDTH], value[WIDTH], derivative[WIDTH];
            memcpy(given, inputs + row * inputs_ld + first, sizeof(REAL) * (size_t)count);
            for (int k = 0; k < WIDTH; k++) {
                REAL start = columns[first + k], end = ends[first + k];
                x[k] = given[k] < start ? start : given[k];
                x[k] = x[k] > end ? end : x[k];
            }
            for (int number = 0; number < NUMBERS; number++) {
                const REAL *column = columns + number * padded + first;
                for (int k = 0; k < WIDTH; k++) part[number][k] = column[k];
            }
            for (Index segment = 1; segment < segments; segment++) {
                const REAL *starts = columns + segment * NUMBERS * padded + first;
                for (int number = 0; number < NUMBERS; number++) {
                    const REAL *column = starts + number * padded;
                    for (int k = 0; k < WIDTH; k++) part[number][k] = x[k] >= starts[k] ? column[k] : part[number][k];
                }
            }
            for (int k = 0; k < WIDTH; k++) target[k] = (x[k] - part[0][k]) / part[1][k];
            NAME(solve)(part[2], part[3], part[4], target, t);
            for (int k = 0; k < WIDTH; k++) {
                REAL along = (3 * part[2][k] * t[k] + 2 * part[3][k]) * t[k] + part[4][k];
                along = (along < EPSILON ? EPSILON : along) * part[1][k];
                REAL rise = ((3 * part[5][k] * t[k] + 2 * part[6][k]) * t[k] + part[7][k]) / along;
                derivative[k] = x[k] == given[k] ? rise : 0;
                value[k] = ((part[5][k] * t[k] + part[6][k]) * t[k] + part[7][k]) * t[k] + part[8][k];
                value[k] = x[k] == x[k] ? value[k] : x[k];
            }
            memcpy(values + row * values_ld + first, value, sizeof(REAL) * (size_t)count);
            if (derivatives) memcpy(derivatives + row * derivatives_ld + first, derivative, sizeof(REAL) * (size_t)count);
        }
    }
    free(columns);
    return 0;
}

#undef WIDTH
#undef ITERATIONS
#undef NUMBERS
