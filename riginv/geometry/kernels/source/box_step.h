/* riginv.solvers.box_step.box_step: a quadratic model of each mesh, minimised over the box from 0 to 1, nearly. */

typedef struct {
    REAL *a, *l, *inverse, *right;     /* of the free controls */
    double *exact_a, *exact_l, *exact_inverse, *exact_right;
    Index *free;                       /* their numbers */
} NAME(Work);

static void NAME(release)(NAME(Work) *work) {
    free(work->a);
    free(work->exact_a);
    free(work->free);
}

static int NAME(reserve)(NAME(Work) *work, Index controls) {
    size_t rows = (size_t)(controls + PADDING), square = rows * rows;
    work->a = malloc(sizeof(REAL) * (2 * square + 2 * rows));
    work->exact_a = sizeof(REAL) == sizeof(double) ? NULL : malloc(sizeof(double) * (2 * square + 2 * rows));
    work->free = malloc(sizeof(Index) * rows);
    if (!work->a || !work->free || (sizeof(REAL) != sizeof(double) && !work->exact_a)) return NAME(release)(work), 1;
    work->l = work->a + square;
    work->inverse = work->l + square;
    work->right = work->inverse + rows;
    if (work->exact_a) {
        work->exact_l = work->exact_a + square;
        work->exact_inverse = work->exact_l + square;
        work->exact_right = work->exact_inverse + rows;
    }
    return 0;
}

/* Solve for the free controls, of which `right` holds what is wanted; in float64 where float32 fails, 0 where that fails too. */
static void NAME(solve_free)(NAME(Work) *work, const REAL *matrix, const REAL *diagonal, Index controls, Index count) {
    Index ld = (count + PADDING - 1) / PADDING * PADDING, rows = (count + ROWS - 1) / ROWS * ROWS;
    memset(work->a, 0, sizeof(REAL) * (size_t)(rows * ld));
    memset(work->l, 0, sizeof(REAL) * (size_t)(rows * ld));
    for (Index i = 0; i < count; i++) {
        const REAL *row = matrix + work->free[i] * controls;
        for (Index j = 0; j <= i; j++) work->a[i * ld + j] = row[work->free[j]];
        if (diagonal) work->a[i * ld + i] += diagonal[work->free[i]];
    }
    if (NAME(cholesky)(work->a, work->l, work->inverse, count, ld)) {
        NAME(substitute)(work->l, work->inverse, work->right, count, ld);
        return;
    }
#ifdef EXACT
    if (work->exact_a) {
        memset(work->exact_l, 0, sizeof(double) * (size_t)(rows * ld));
        for (Index i = 0; i < rows * ld; i++) work->exact_a[i] = work->a[i];
        for (Index i = 0; i < count; i++) work->exact_right[i] = work->right[i];
        if (cholesky_f64(work->exact_a, work->exact_l, work->exact_inverse, count, ld)) {
            substitute_f64(work->exact_l, work->exact_inverse, work->exact_right, count, ld);
            for (Index i = 0; i < count; i++) work->right[i] = (REAL)work->exact_right[i];
            return;
        }
    }
#endif
    memset(work->right, 0, sizeof(REAL) * (size_t)count);
}

/* matrices (batch, control, control), `each` numbers apart (0: one for all); diagonal (batch, control) is added to theirs, or
 * NULL; gradient, at and step (batch, control). rounds: of solving and pinning what leaves the box.
 */
API int NAME(box_step)(const REAL *matrices, Index each, const REAL *diagonal, const REAL *gradient, const REAL *at, REAL *step,
                       Index controls, Index rounds, Index batch) {
    NAME(Work) work;
    REAL *target = malloc(sizeof(REAL) * (size_t)(controls + 1));
    char *is_free = malloc((size_t)(controls + 1));
    if (!target || !is_free || NAME(reserve)(&work, controls)) return free(target), free(is_free), 1;
    for (Index mesh = 0; mesh < batch; mesh++) {
        const REAL *matrix = matrices + mesh * each, *added = diagonal ? diagonal + mesh * controls : NULL;
        const REAL *derivative = gradient + mesh * controls, *here = at + mesh * controls;
        REAL *way = step + mesh * controls;
        for (Index i = 0; i < controls; i++) {
            is_free[i] = !((here[i] <= 0 && derivative[i] > 0) || (here[i] >= 1 && derivative[i] < 0));
            way[i] = 0;
        }
        for (Index round = 0; round < rounds; round++) {
            Index count = 0, leaving = 0;
            for (Index i = 0; i < controls; i++)
                if (is_free[i]) work.free[count++] = i;
            for (Index i = 0; i < count; i++) {
                const REAL *row = matrix + work.free[i] * controls;
                REAL sum = 0;
                if (round)
                    for (Index j = 0; j < controls; j++) sum += is_free[j] ? 0 : row[j] * way[j];
                work.right[i] = -derivative[work.free[i]] - sum;
            }
            NAME(solve_free)(&work, matrix, added, controls, count);
            for (Index i = 0; i < count; i++) target[work.free[i]] = here[work.free[i]] + work.right[i];
            for (Index i = 0; i < count; i++) {
                Index control = work.free[i];
                REAL end = target[control], inside = end < 0 ? 0 : end > 1 ? 1 : end;
                way[control] = inside - here[control];
                if (end != inside) {
                    leaving = 1;
                    is_free[control] = 0;
                }
            }
            if (!leaving) break;
        }
    }
    NAME(release)(&work);
    free(target);
    free(is_free);
    return 0;
}

/* g . s + s . H s / 2 of each mesh, (batch,). */
API int NAME(foreseen)(const REAL *matrices, const REAL *gradient, const REAL *step, REAL *result, Index controls, Index batch) {
    for (Index mesh = 0; mesh < batch; mesh++) {
        const REAL *matrix = matrices + mesh * controls * controls, *way = step + mesh * controls;
        REAL sum = 0;
        for (Index i = 0; i < controls; i++) {
            if (way[i] == 0) continue;
            const REAL *row = matrix + i * controls;
            NAME(Lanes) lanes = {0};
            REAL rest = 0;
            Index j = 0;
            for (; j + LANES <= controls; j += LANES) lanes += NAME(load)(row + j) * NAME(load)(way + j);
            for (; j < controls; j++) rest += row[j] * way[j];
            sum += way[i] * (gradient[mesh * controls + i] + (rest + NAME(total)(lanes)) / 2);
        }
        result[mesh] = sum;
    }
    return 0;
}
