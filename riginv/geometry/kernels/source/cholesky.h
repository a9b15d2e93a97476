/* Symmetric positive definite systems of some hundred unknowns, and the step in a box that needs them. */

/* Matrices are stored row by row; rows are a multiple of PADDING numbers apart, filled up with 0, and so is their count of ROWS. */
#define PADDING 8
#define ROWS 4
typedef REAL NAME(Lanes) __attribute__((vector_size(32)));
#define LANES ((Index)(32 / sizeof(REAL)))

static inline NAME(Lanes) NAME(load)(const REAL *from) {
    NAME(Lanes) lanes;
    memcpy(&lanes, from, sizeof lanes);
    return lanes;
}

static inline REAL NAME(total)(NAME(Lanes) lanes) {
    REAL sum = 0;
    for (Index lane = 0; lane < LANES; lane++) sum += lanes[lane];
    return sum;
}

static inline REAL NAME(dot)(const REAL *one, const REAL *other, Index count) {
    NAME(Lanes) sum = {0};
    for (Index k = 0; k < count; k += LANES) sum += NAME(load)(one + k) * NAME(load)(other + k);
    return NAME(total)(sum);
}

/* The lower factor L of A = L L^T, and the inverse of its diagonal. A and L have rows of ld numbers, L starts as 0.
 *
 * Returns whether A is positive definite in this precision.
 */
static int NAME(cholesky)(const REAL *a, REAL *l, REAL *inverse, Index size, Index ld) {
    for (Index first = 0; first < size; first += ROWS) {
        const REAL *from = a + first * ld;
        REAL *row = l + first * ld;
        for (Index j = 0; j < first; j++) {
            const REAL *other = l + j * ld;
            NAME(Lanes) zero = {0}, one = {0}, two = {0}, three = {0};
            for (Index k = 0; k < j; k += LANES) {
                NAME(Lanes) value = NAME(load)(other + k);
                zero += value * NAME(load)(row + k);
                one += value * NAME(load)(row + ld + k);
                two += value * NAME(load)(row + 2 * ld + k);
                three += value * NAME(load)(row + 3 * ld + k);
            }
            row[j] = (from[j] - NAME(total)(zero)) * inverse[j];
            row[ld + j] = (from[ld + j] - NAME(total)(one)) * inverse[j];
            row[2 * ld + j] = (from[2 * ld + j] - NAME(total)(two)) * inverse[j];
            row[3 * ld + j] = (from[3 * ld + j] - NAME(total)(three)) * inverse[j];
        }
        for (Index i = first; i < size && i < first + ROWS; i++) {
            REAL *here = l + i * ld;
            for (Index j = first; j < i; j++) here[j] = (a[i * ld + j] - NAME(dot)(here, l + j * ld, j)) * inverse[j];
            REAL pivot = a[i * ld + i] - NAME(dot)(here, here, i);
            if (!(pivot > 0) || !(pivot < INFINITY)) return 0;
            here[i] = SQRT(pivot);
            inverse[i] = 1 / here[i];
        }
    }
    return 1;
}

/* Solve L L^T x = right, in place. */
static void NAME(substitute)(const REAL *l, const REAL *inverse, REAL *right, Index size, Index ld) {
    for (Index i = 0; i < size; i++) {
        REAL sum = 0;
        const REAL *row = l + i * ld;
        NAME(Lanes) lanes = {0};
        Index k = 0;
        for (; k + LANES <= i; k += LANES) lanes += NAME(load)(row + k) * NAME(load)(right + k);
        for (; k < i; k++) sum += row[k] * right[k];
        right[i] = (right[i] - (sum + NAME(total)(lanes))) * inverse[i];
    }
    for (Index i = size - 1; i >= 0; i--) {
        const REAL *row = l + i * ld;
        REAL value = right[i] * inverse[i];
        right[i] = value;
        for (Index k = 0; k < i; k++) right[k] -= value * row[k];
    }
}
