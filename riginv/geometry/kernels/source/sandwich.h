/* riginv.geometry.jacobian.Jacobian.gram: ... F2^T F1^T M F1 F2 ... for sparse factors F and a symmetric M. */

/* sums (count,) = the rows of a metric that some entries stand in, each times its entry. */
static void NAME(add_rows)(const REAL *metric, Index count, const REAL *value, const int32_t *place, Index entries, REAL *sums) {
    memset(sums, 0, sizeof(REAL) * (size_t)count);
    Index entry = 0;
    while (entry < entries) {
        const REAL *row[4];
        REAL weight[4] = {0, 0, 0, 0};
        int found = 0;
        for (; entry < entries && found < 4; entry++) {
            if (value[entry] == 0) continue;
            weight[found] = value[entry];
            row[found++] = metric + place[entry] * count;
        }
        if (found == 1) {
            for (Index k = 0; k < count; k++) sums[k] += weight[0] * row[0][k];
        } else if (found) {
            for (int rest = found; rest < 4; rest++) row[rest] = row[0];
            for (Index k = 0; k < count; k++)
                sums[k] += (weight[0] * row[0][k] + weight[1] * row[1][k]) + (weight[2] * row[2][k] + weight[3] * row[3][k]);
        }
    }
}

/* One row of the result, from the diagonal on. */
static void NAME(sandwich_row)(const REAL *metric, Index rows, const REAL *value, const int32_t *place, const int32_t *starts,
                               Index column, Index columns, REAL *half, REAL *out) {
    NAME(add_rows)(metric, rows, value + starts[column], place + starts[column], starts[column + 1] - starts[column], half);
    int32_t entry = starts[column];
    for (Index other = column; other < columns; other++) {
        REAL sum = 0;
        for (; entry < starts[other + 1]; entry++) sum += value[entry] * half[place[entry]];
        out[other] = sum;
    }
}

typedef struct {
    Index rows, columns, entries;
    const REAL *values;
    int32_t *place, *start; /* rows of the entries in order of their columns; where each column's begin */
} NAME(Factor);

static void NAME(mirror)(REAL *square, Index columns) {
    enum { TILE = 16 };
    for (Index row = 0; row < columns; row += TILE)
        for (Index first = 0; first <= row; first += TILE)
            for (Index i = row; i < columns && i < row + TILE; i++)
                for (Index j = first; j < i && j < first + TILE; j++) square[i * columns + j] = square[j * columns + i];
}

/* One factor around the metrics of `block` meshes, `each` numbers apart; 0: one metric for all. */
static void NAME(around)(const NAME(Factor) *factor, Index mesh, Index block, const REAL *metric, Index each, REAL *half,
                         REAL *result) {
    const Index columns = factor->columns, square = columns * columns;
    for (Index column = 0; column < columns; column++)
        for (Index number = 0; number < block; number++)
            NAME(sandwich_row)(metric + number * each, factor->rows, factor->values + (mesh + number) * factor->entries,
                               factor->place, factor->start, column, columns, half, result + number * square + column * columns);
    for (Index number = 0; number < block; number++) NAME(mirror)(result + number * square, columns);
}

/* metric (row, row), one for all meshes. table (factor, 6): rows, columns and entries of each factor, then the addresses of its
 * values (batch, entry) and of the rows of these (entry,), both in order of the columns, and of starts (column + 1,): those of
 * a column run from starts[column] to starts[column + 1]. result (batch, column, column) of the last factor.
 */
API int NAME(sandwich)(const REAL *metric, const Index *table, Index factors, REAL *result, Index batch) {
    enum { BLOCK = 8 }; /* meshes for which a few rows of the first metric stay in the cache */
    Index numbers = 0, widest = 0;
    for (Index number = 0; number < factors; number++) {
        const Index *row = table + 6 * number;
        numbers += row[2] + row[1] + 1;
        if (row[0] > widest) widest = row[0];
        if (row[1] > widest) widest = row[1];
    }
    Index largest = 0;
    for (Index number = 0; number < factors; number++)
        if (table[6 * number + 1] > largest) largest = table[6 * number + 1];
    const size_t square = (size_t)(largest * largest);
    NAME(Factor) *factor = malloc(sizeof *factor * (size_t)factors);
    int32_t *places = malloc(sizeof(int32_t) * (size_t)numbers);
    REAL *half = malloc(sizeof(REAL) * ((size_t)widest + (BLOCK + 2) * square));
    if (!factor || !places || !half) return free(factor), free(places), free(half), 1;
    REAL *first = half + widest, *one = first + BLOCK * square, *other = one + square;
    int32_t *next = places;
    for (Index number = 0; number < factors; number++) {
        const Index *row = table + 6 * number, *from = (const Index *)(uintptr_t)row[4], *starts = (const Index *)(uintptr_t)row[5];
        NAME(Factor) made = {row[0], row[1], row[2], (const REAL *)(uintptr_t)row[3], next, next + row[2]};
        for (Index entry = 0; entry < made.entries; entry++) made.place[entry] = (int32_t)from[entry];
        for (Index column = 0; column <= made.columns; column++) made.start[column] = (int32_t)starts[column];
        next += made.entries + made.columns + 1;
        factor[number] = made;
    }
    const Index last = factors - 1, out = factor[last].columns * factor[last].columns;
    for (Index mesh = 0; mesh < batch; mesh += BLOCK) {
        const Index block = batch - mesh < BLOCK ? batch - mesh : BLOCK, width = factor[0].columns * factor[0].columns;
        NAME(around)(factor, mesh, block, metric, 0, half, last ? first : result + mesh * out);
        for (Index number = 0; last && number < block; number++) { /* a mesh's own metric stays in the cache */
            const REAL *from = first + number * width;
            for (Index step = 1; step <= last; step++) {
                REAL *to = step == last ? result + (mesh + number) * out : step % 2 ? one : other;
                NAME(around)(factor + step, mesh + number, 1, from, 0, half, to);
                from = to;
            }
        }
    }
    free(factor);
    free(places);
    free(half);
    return 0;
}
