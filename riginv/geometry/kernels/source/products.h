/* Products of a few factors each: riginv.geometry.blendshapes.combination_weights, and screen, whose factors are 1 - a. */

/* A row of factors, or of 1 minus them, with a 1 behind it, which empty slots stand for. */
static inline void NAME(pad)(const REAL *row, Index factors, Index complement, REAL *padded) {
    if (complement)
        for (Index factor = 0; factor < factors; factor++) padded[factor] = 1 - row[factor];
    else
        memcpy(padded, row, sizeof(REAL) * (size_t)factors);
    padded[factors] = 1;
}

/* members (product, slot) index columns of given (batch, factor); results (batch, product).
 *
 * complement: 1 minus the product of 1 minus the factors.
 */
API int NAME(products)(const REAL *given, Index given_ld, Index factors, const Index *members, Index products, Index slots, Index complement,
                       REAL *results, Index results_ld, Index batch) {
    REAL *padded = malloc(sizeof(REAL) * (size_t)(factors + 1));
    int32_t *places = malloc(sizeof(int32_t) * (size_t)(products * slots + 1));
    if (!padded || !places) return free(padded), free(places), 1;
    for (Index place = 0; place < products * slots; place++)
        places[place] = (int32_t)(members[place] < 0 ? factors : members[place]);
    for (Index row = 0; row < batch; row++) {
        REAL *result = results + row * results_ld;
        NAME(pad)(given + row * given_ld, factors, complement, padded);
        for (Index product = 0; product < products; product++) {
            const int32_t *place = places + product * slots;
            REAL value = 1;
            for (Index slot = 0; slot < slots; slot++) value *= padded[place[slot]];
            result[product] = complement ? 1 - value : value;
        }
    }
    free(padded);
    free(places);
    return 0;
}

/* A gradient (batch, product) of results as one (batch, factor) of what is given. */
API int NAME(products_pull)(const REAL *given, Index given_ld, Index factors, const Index *members, Index products, Index slots,
                            Index complement, const REAL *gradient, Index gradient_ld, REAL *pulled, Index batch) {
    REAL *padded = malloc(sizeof(REAL) * (size_t)(2 * (factors + 1) + slots));
    int32_t *places = malloc(sizeof(int32_t) * (size_t)(products * slots + 1));
    if (!padded || !places) return free(padded), free(places), 1;
    REAL *sums = padded + factors + 1, *before = sums + factors + 1;
    for (Index place = 0; place < products * slots; place++)
        places[place] = (int32_t)(members[place] < 0 ? factors : members[place]);
    for (Index row = 0; row < batch; row++) {
        const REAL *wanted = gradient + row * gradient_ld;
        NAME(pad)(given + row * given_ld, factors, complement, padded);
        memset(sums, 0, sizeof(REAL) * (size_t)(factors + 1));
        for (Index product = 0; product < products; product++) {
            const int32_t *place = places + product * slots;
            REAL value = wanted[product];
            if (slots == 3) {
                REAL one = padded[place[0]], two = padded[place[1]], three = padded[place[2]];
                sums[place[0]] += value * (two * three);
                sums[place[1]] += value * (one * three);
                sums[place[2]] += value * (one * two);
                continue;
            }
            for (Index slot = 0; slot < slots; slot++) { /* the gradient times all factors before a slot, */
                before[slot] = value;
                value *= padded[place[slot]];
            }
            value = 1;
            for (Index slot = slots - 1; slot >= 0; slot--) { /* times all behind it */
                sums[place[slot]] += before[slot] * value;
                value *= padded[place[slot]];
            }
        }
        memcpy(pulled + row * factors, sums, sizeof(REAL) * (size_t)factors);
    }
    free(padded);
    free(places);
    return 0;
}

/* The derivative (batch, product, slot) of each product by the factor in each slot; 0 in empty slots. */
API int NAME(products_derivatives)(const REAL *given, Index given_ld, Index factors, const Index *members, Index products,
                              Index slots, Index complement, REAL *derivatives, Index batch) {
    REAL *padded = malloc(sizeof(REAL) * (size_t)(factors + 1));
    if (!padded) return 1;
    for (Index row = 0; row < batch; row++) {
        NAME(pad)(given + row * given_ld, factors, complement, padded);
        for (Index product = 0; product < products; product++) {
            const Index *member = members + product * slots;
            REAL *derivative = derivatives + (row * products + product) * slots, value = 1;
            for (Index slot = 0; slot < slots; slot++) {
                derivative[slot] = value;
                value *= padded[member[slot] < 0 ? factors : member[slot]];
            }
            value = 1;
            for (Index slot = slots - 1; slot >= 0; slot--) {
                derivative[slot] = member[slot] < 0 ? 0 : derivative[slot] * value;
                value *= padded[member[slot] < 0 ? factors : member[slot]];
            }
        }
    }
    free(padded);
    return 0;
}

/* sums (batch, column) of entries (batch, entry), each times its scale where there is one, by the column of each entry. */
API int NAME(add_to_columns)(const REAL *entries, Index entries_ld, const REAL *scales, Index scales_ld, const Index *columns,
                             Index count, REAL *sums, Index sums_ld, Index batch) {
    for (Index row = 0; row < batch; row++) {
        const REAL *entry = entries + row * entries_ld, *scale = scales ? scales + row * scales_ld : NULL;
        REAL *sum = sums + row * sums_ld;
        if (scale)
            for (Index number = 0; number < count; number++) sum[columns[number]] += entry[number] * scale[number];
        else
            for (Index number = 0; number < count; number++) sum[columns[number]] += entry[number];
    }
    return 0;
}
