/* riginv.solvers.band: block Cholesky of a matrix for every frame, coupled to the next two frames by multiples of the identity.
 *
 * Only the free controls of each frame count; those of frame f are numbers[starts[f]] to numbers[starts[f + 1]], in order. A
 * chain of frames is eliminated from one end; its last two are separators, between it and another chain that is eliminated from
 * the other end, perhaps by another thread at the same time.
 */

typedef struct {
    const double *blocks, *added; /* (frame, control, control), and (frame, control) to add to their diagonals */
    const double *near, *far;     /* (frame,): what couples a frame to the next and to the second next */
    const double *right;          /* (frame, control) */
    const Index *starts, *numbers;
    Index controls;
} Band;

static inline Index free_count(const Band *band, Index frame) {
    return frame < 0 ? 0 : band->starts[frame + 1] - band->starts[frame];
}

static inline Index padded(Index count) { return (count + 7) / 8 * 8; }

/* coupling (row of free controls of one frame, column of those of the other) = weight where both are the same control. */
static void couple(const Band *band, Index frame, Index other, double weight, double *coupling, Index ld) {
    const Index *one = band->numbers + band->starts[frame], *two = band->numbers + band->starts[other];
    Index rows = free_count(band, frame), columns = free_count(band, other), j = 0;
    for (Index i = 0; i < rows; i++) {
        while (j < columns && two[j] < one[i]) j++;
        if (j < columns && two[j] == one[i]) coupling[i * ld + j] += weight;
    }
}

/* The free part of a frame's block, lower triangle, less a correction (or NULL). a has rows of ld numbers. */
static void gather_block(const Band *band, Index frame, const double *correction, Index correction_ld, double *a, Index ld) {
    const Index *number = band->numbers + band->starts[frame], count = free_count(band, frame), controls = band->controls;
    const double *block = band->blocks + frame * controls * controls, *added = band->added + frame * controls;
    for (Index i = 0; i < count; i++) {
        for (Index j = 0; j <= i; j++) a[i * ld + j] = block[number[i] * controls + number[j]];
        a[i * ld + i] += added[number[i]];
        if (correction)
            for (Index j = 0; j <= i; j++) a[i * ld + j] -= correction[i * correction_ld + j];
    }
}

/* wide (row, width) <- L^-1 wide. */
static void solve_rows(const double *l, const double *inverse, Index rows, Index ld, double *wide, Index width) {
    for (Index i = 0; i < rows; i++) {
        const double *row = l + i * ld;
        double *here = wide + i * width;
        Index k = 0;
        for (; k + 4 <= i; k += 4) {
            const double *from = wide + k * width;
            for (Index j = 0; j < width; j++)
                here[j] -= (row[k] * from[j] + row[k + 1] * from[width + j]) +
                           (row[k + 2] * from[2 * width + j] + row[k + 3] * from[3 * width + j]);
        }
        for (; k < i; k++)
            for (Index j = 0; j < width; j++) here[j] -= row[k] * wide[k * width + j];
        for (Index j = 0; j < width; j++) here[j] *= inverse[i];
    }
}

/* square (width, width) <- wide^T wide, lower triangle, in tiles of 4 rows and 8 columns. */
static void self_product(const double *wide, Index rows, Index width, double *square) {
    for (Index i = 0; i < width; i += 4)
        for (Index j = 0; j <= i + 3; j += 8) {
            Lanes_f64 sums[4][2] = {{{0}}};
            for (Index k = 0; k < rows; k++) {
                const double *row = wide + k * width;
                Lanes_f64 low = load_f64(row + j), high = load_f64(row + j + 4);
                for (int a = 0; a < 4; a++) {
                    sums[a][0] += row[i + a] * low;
                    sums[a][1] += row[i + a] * high;
                }
            }
            for (int a = 0; a < 4; a++) {
                memcpy(square + (i + a) * width + j, &sums[a][0], sizeof sums[a][0]);
                memcpy(square + (i + a) * width + j + 4, &sums[a][1], sizeof sums[a][1]);
            }
        }
}

/* Eliminate a chain. corrections (3, controls, controls): what it takes from the blocks of the first and the second separator
 * and, (first, second), from that between them; pulled (2, controls): what it takes from their right sides.
 *
 * Returns 2 where the matrix is not positive definite.
 */
API int band_eliminate_f64(const double *blocks, const double *added, const double *near, const double *far, const double *right,
                           const Index *starts, const Index *numbers, Index controls, const Index *frames, Index count,
                           double *store, const Index *offsets, double *corrections, double *pulled) {
    const Band band = {blocks, added, near, far, right, starts, numbers, controls};
    const Index square = controls * controls, widest = padded(2 * controls + 1);
    double *to_next = corrections + 2 * square, *products = malloc(sizeof(double) * (size_t)(widest * widest));
    double *a = malloc(sizeof(double) * (size_t)((controls + 8) * padded(controls)));
    double *first = corrections, *second = corrections + square, *pull_first = pulled, *pull_second = pulled + controls;
    int code = !products || !a;
    for (Index position = 0; position < count && !code; position++) {
        const Index frame = frames[position], next = frames[position + 1], after = frames[position + 2];
        const Index size = free_count(&band, frame), near_size = free_count(&band, next), far_size = free_count(&band, after);
        const Index ld = padded(size), rows = (size + 3) / 4 * 4, width = padded(near_size + far_size + 1);
        double *l = store + offsets[position], *inverse = l + rows * ld, *wide = inverse + ld;
        memset(a, 0, sizeof(double) * (size_t)(rows * ld));
        memset(l, 0, sizeof(double) * (size_t)(rows * ld + ld + size * width));
        gather_block(&band, frame, first, controls, a, ld);
        if (!cholesky_f64(a, l, inverse, size, ld)) {
            code = 2;
            break;
        }
        if (next >= 0) couple(&band, frame, next, band.near[frame < next ? frame : next], wide, width);
        if (after >= 0) couple(&band, frame, after, band.far[frame < after ? frame : after], wide + near_size, width);
        for (Index i = 0; i < size; i++) {
            for (Index j = 0; j < near_size; j++) wide[i * width + j] -= to_next[i * controls + j];
            wide[i * width + near_size + far_size] =
                band.right[frame * controls + band.numbers[band.starts[frame] + i]] - pull_first[i];
        }
        solve_rows(l, inverse, size, ld, wide, width);
        self_product(wide, size, width, products);
        /* What the frame takes from the next two moves up by one. */
        double *swap = first;
        first = second;
        second = swap;
        swap = pull_first;
        pull_first = pull_second;
        pull_second = swap;
        const double *last = products + (near_size + far_size) * width;
        for (Index i = 0; i < near_size; i++) {
            for (Index j = 0; j <= i; j++) first[i * controls + j] += products[i * width + j];
            pull_first[i] += last[i];
        }
        for (Index i = 0; i < far_size; i++) {
            const double *row = products + (near_size + i) * width;
            for (Index j = 0; j <= i; j++) second[i * controls + j] = row[near_size + j];
            for (Index j = 0; j < near_size; j++) to_next[j * controls + i] = row[j];
            pull_second[i] = last[near_size + i];
        }
    }
    if (!code && count % 2) { /* after an odd number of swaps the two stand the other way round */
        for (Index i = 0; i < square; i++) {
            double value = corrections[i];
            corrections[i] = corrections[square + i];
            corrections[square + i] = value;
        }
        for (Index i = 0; i < controls; i++) {
            double value = pulled[i];
            pulled[i] = pulled[controls + i];
            pulled[controls + i] = value;
        }
    }
    free(products);
    free(a);
    return code;
}

/* Solve for the two separators, next to each other; of two chains, the second of which has them in the other order. */
API int band_middle_f64(const double *blocks, const double *added, const double *near, const double *far, const double *right,
                        const Index *starts, const Index *numbers, Index controls, Index frame, Index next,
                        const double *corrections, const double *pulled, const double *other_corrections,
                        const double *other_pulled, double *found) {
    const Band band = {blocks, added, near, far, right, starts, numbers, controls};
    const Index square = controls * controls, size = free_count(&band, frame), next_size = free_count(&band, next);
    const Index total = size + next_size, ld = padded(total), rows = (total + 3) / 4 * 4;
    double *a = calloc((size_t)(2 * rows * ld + 2 * ld + square), sizeof(double));
    if (!a) return 1;
    double *l = a + rows * ld, *inverse = l + rows * ld, *solved = inverse + ld, *coupling = solved + ld;
    gather_block(&band, frame, corrections, controls, a, ld);
    for (Index i = 0; i < size; i++)
        for (Index j = 0; j <= i; j++) a[i * ld + j] -= other_corrections[square + i * controls + j];
    if (next >= 0) {
        gather_block(&band, next, corrections + square, controls, a + size * ld + size, ld);
        couple(&band, frame, next, band.near[frame], coupling, controls);
    }
    for (Index i = 0; i < next_size; i++) {
        double *row = a + (size + i) * ld;
        for (Index j = 0; j <= i; j++) row[size + j] -= other_corrections[i * controls + j];
        for (Index j = 0; j < size; j++)
            row[j] = coupling[j * controls + i] - corrections[2 * square + j * controls + i] -
                     other_corrections[2 * square + i * controls + j];
    }
    for (Index i = 0; i < size; i++)
        solved[i] = band.right[frame * controls + band.numbers[band.starts[frame] + i]] - pulled[i] - other_pulled[controls + i];
    for (Index i = 0; i < next_size; i++)
        solved[size + i] =
            band.right[next * controls + band.numbers[band.starts[next] + i]] - pulled[controls + i] - other_pulled[i];
    int code = cholesky_f64(a, l, inverse, total, ld) ? 0 : 2;
    if (!code) {
        substitute_f64(l, inverse, solved, total, ld);
        for (Index i = 0; i < size; i++) found[frame * controls + band.numbers[band.starts[frame] + i]] = solved[i];
        for (Index i = 0; i < next_size; i++) found[next * controls + band.numbers[band.starts[next] + i]] = solved[size + i];
    }
    free(a);
    return code;
}

/* Solve for the frames of a chain, of which the separators are found already. */
API int band_substitute_f64(const Index *starts, const Index *numbers, Index controls, const Index *frames, Index count,
                            const double *store, const Index *offsets, double *found) {
    const Band band = {NULL, NULL, NULL, NULL, NULL, starts, numbers, controls};
    for (Index position = count - 1; position >= 0; position--) {
        const Index frame = frames[position], size = free_count(&band, frame);
        const Index near_size = free_count(&band, frames[position + 1]), far_size = free_count(&band, frames[position + 2]);
        const Index ld = padded(size), rows = (size + 3) / 4 * 4, width = padded(near_size + far_size + 1);
        const double *l = store + offsets[position], *inverse = l + rows * ld, *wide = inverse + ld;
        const Index *number = numbers + starts[frame];
        double *here = found + frame * controls;
        for (Index i = 0; i < size; i++) {
            double value = wide[i * width + near_size + far_size];
            for (Index side = 0; side < 2; side++) {
                const Index other = frames[position + 1 + side], others = side ? far_size : near_size;
                const double *row = wide + i * width + (side ? near_size : 0);
                for (Index j = 0; j < others; j++) value -= row[j] * found[other * controls + numbers[starts[other] + j]];
            }
            here[number[i]] = value;
        }
        for (Index i = size - 1; i >= 0; i--) {
            const double *row = l + i * ld;
            double value = here[number[i]] * inverse[i];
            here[number[i]] = value;
            for (Index k = 0; k < i; k++) here[number[k]] -= value * row[k];
        }
    }
    return 0;
}
