/* riginv.networks.quasi_newton: L-BFGS from a diagonal, between evaluations of the error.
 *
 * units, gradient, found and found_gradient are (batch, control), cost, found_cost and length (batch,). steps and changes, the
 * pairs so far, are (batch, most, control), inverses (batch, most). limits: the longest step, the factor of a step that failed,
 * and the least inner product of a pair, relative and absolute.
 */

static inline REAL NAME(inner)(const REAL *one, const REAL *other, Index count) {
    REAL sum = 0;
#pragma omp simd reduction(+ : sum)
    for (Index k = 0; k < count; k++) sum += one[k] * other[k];
    return sum;
}

/* found: where the next step leads. neutral (control,), diagonals (2, control): of the Hessian above and below neutral. */
API int NAME(quasi_newton_step)(const REAL *units, const REAL *gradient, const REAL *length, const REAL *steps, const REAL *changes,
                                const REAL *inverses, Index pairs, Index most, const REAL *neutral, const REAL *diagonals,
                                const REAL *limits, REAL *found, Index controls, Index batch) {
    REAL *factors = malloc(sizeof(REAL) * (size_t)(pairs + 1));
    if (!factors) return 1;
    for (Index row = 0; row < batch; row++, units += controls, gradient += controls, found += controls) {
        const REAL *step = steps + row * most * controls, *change = changes + row * most * controls, *inverse = inverses + row * most;
        memcpy(found, gradient, sizeof(REAL) * (size_t)controls);
        for (Index pair = pairs - 1; pair >= 0; pair--) {
            const REAL factor = factors[pair] = inverse[pair] * NAME(inner)(step + pair * controls, found, controls);
            for (Index k = 0; k < controls; k++) found[k] -= factor * change[pair * controls + k];
        }
        for (Index k = 0; k < controls; k++)
            found[k] /= units[k] < neutral[k] && neutral[k] < 1 ? diagonals[controls + k] : diagonals[k];
        for (Index pair = 0; pair < pairs; pair++) {
            const REAL rest = factors[pair] - inverse[pair] * NAME(inner)(change + pair * controls, found, controls);
            for (Index k = 0; k < controls; k++) found[k] += rest * step[pair * controls + k];
        }
        for (Index k = 0; k < controls; k++) {
            REAL move = -length[row] * found[k];
            move = move < -limits[0] ? -limits[0] : move > limits[0] ? limits[0] : move;
            move += units[k];
            found[k] = move < 0 ? 0 : move > 1 ? 1 : move;
        }
    }
    free(factors);
    return 0;
}

/* Keeps what was found where its cost is lower, and the step to it as pair number `pair`; NULL as found_gradient: no pair follows. */
API int NAME(quasi_newton_keep)(const REAL *found, const REAL *found_cost, const REAL *found_gradient, REAL *units, REAL *cost,
                                REAL *gradient, REAL *length, REAL *steps, REAL *changes, REAL *inverses, Index pair, Index most,
                                const REAL *limits, Index controls, Index batch) {
    const size_t size = sizeof(REAL) * (size_t)controls;
    for (Index row = 0; row < batch; row++, found += controls, units += controls) {
        const int is_better = found_cost[row] < cost[row];
        if (found_gradient) {
            const REAL *after = found_gradient + row * controls;
            REAL *before = gradient + row * controls, *step = steps + (row * most + pair) * controls,
                 *change = changes + (row * most + pair) * controls;
            for (Index k = 0; k < controls; k++) step[k] = found[k] - units[k];
            for (Index k = 0; k < controls; k++) change[k] = after[k] - before[k];
            const REAL product = NAME(inner)(step, change, controls);
            const REAL sizes = SQRT(NAME(inner)(step, step, controls)) * SQRT(NAME(inner)(change, change, controls));
            inverses[row * most + pair] = product > limits[2] * sizes ? 1 / (product < limits[3] ? limits[3] : product) : 0;
            if (is_better) memcpy(before, after, size);
        }
        length[row] = is_better ? 1 : limits[1] * length[row];
        if (is_better) memcpy(units, found, size), cost[row] = found_cost[row];
    }
    return 0;
}
