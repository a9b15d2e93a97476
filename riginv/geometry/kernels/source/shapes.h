/* A chain of blendshape logic, forward and backward: the steps of rigs.face.derivatives.FaceSteps in one call.
 *
 * Drivers follow curves of controls and are screened into shapes; shapes with a ceiling stay below a curve of another shape; the
 * sum of each region's shapes, each times its cost, is limited by a curve; in-betweens follow curves of shapes, combinations are
 * products of shapes. Tables of curves are (curve, segment, 9), as in curves.h.
 */

#define LOGIC                                                                                                                  \
    const REAL *driver_table, Index drivers, Index driver_segments, const Index *driver_control, const Index *sources,         \
        Index shapes, Index slots, const REAL *ceiling_table, Index ceilings, Index ceiling_segments,                          \
        const Index *ceiling_shape, const Index *ceiling_under, const REAL *limit_table, Index regions, Index limit_segments,  \
        const Index *region, const REAL *cost, const REAL *between_table, Index betweens, Index between_segments,              \
        const Index *between_shape, const Index *members, Index combinations, Index most

/* state: what each step has found, (batch, column) after (batch, column); weights (batch, shape + in-between + combination). */
#define STATE                                                                                                                  \
    REAL *driven = state, *rise = driven + batch * drivers, *limited = rise + batch * drivers, *below = limited + batch * shapes, \
         *under_derivative = below + batch * ceilings, *yielding = under_derivative + batch * ceilings,                        \
         *yield_derivative = yielding + batch * regions, *factor = yield_derivative + batch * regions,                         \
         *bump = factor + batch * shapes;                                                                                      \
    const Index every = shapes + betweens + combinations

API int NAME(shapes)(LOGIC, const REAL *controls, Index controls_ld, REAL *state, REAL *weights, Index batch) {
    STATE;
    const Index widest = drivers + ceilings + regions + betweens + shapes;
    REAL *inputs = malloc(sizeof(REAL) * (size_t)(widest * batch + 1)), *under = inputs + widest * batch - ceilings * batch;
    if (!inputs) return 1;
    int failed = 0;
    for (Index row = 0; row < batch; row++)
        for (Index driver = 0; driver < drivers; driver++)
            inputs[row * drivers + driver] = controls[row * controls_ld + driver_control[driver]];
    failed |= NAME(curves)(driver_table, drivers, driver_segments, inputs, drivers, driven, drivers, rise, drivers, batch);
    failed |= NAME(products)(driven, drivers, drivers, sources, shapes, slots, 1, limited, shapes, batch);
    for (Index row = 0; row < batch; row++)
        for (Index number = 0; number < ceilings; number++)
            inputs[row * ceilings + number] = limited[row * shapes + ceiling_under[number]];
    failed |= NAME(curves)(ceiling_table, ceilings, ceiling_segments, inputs, ceilings, under, ceilings, under_derivative, ceilings,
                           batch);
    for (Index row = 0; row < batch; row++) {
        REAL *sums = inputs + row * regions, *values = limited + row * shapes;
        for (Index number = 0; number < ceilings; number++) {
            REAL *close = values + ceiling_shape[number];
            const REAL most_now = under[row * ceilings + number];
            below[row * ceilings + number] = *close <= most_now;
            if (!(*close <= most_now)) *close = most_now;
        }
        memset(sums, 0, sizeof(REAL) * (size_t)regions);
        for (Index shape = 0; shape < shapes; shape++) sums[region[shape]] += values[shape] * cost[shape];
    }
    failed |= NAME(curves)(limit_table, regions, limit_segments, inputs, regions, yielding, regions, yield_derivative, regions, batch);
    for (Index row = 0; row < batch; row++) {
        REAL *primary = weights + row * every, *input = inputs + row * betweens;
        for (Index shape = 0; shape < shapes; shape++) {
            const REAL yields = yielding[row * regions + region[shape]];
            factor[row * shapes + shape] = yields;
            primary[shape] = limited[row * shapes + shape] * yields;
        }
        for (Index number = 0; number < betweens; number++) input[number] = primary[between_shape[number]];
    }
    failed |= NAME(curves)(between_table, betweens, between_segments, inputs, betweens, weights + shapes, every, bump, betweens, batch);
    failed |= NAME(products)(weights, every, shapes, members, combinations, most, 0, weights + shapes + betweens, every, batch);
    free(inputs);
    return failed;
}

/* A gradient (batch, weight) as one (batch, control); state and weights are those of the call above. */
API int NAME(shapes_pull)(LOGIC, REAL *state, const REAL *weights, const REAL *gradient, Index gradient_ld, REAL *pulled,
                          Index controls, Index batch) {
    STATE;
    REAL *of_shapes = malloc(sizeof(REAL) * (size_t)(batch * (shapes + drivers) + regions + 1));
    if (!of_shapes) return 1;
    REAL *of_drivers = of_shapes + batch * shapes, *of_regions = of_drivers + batch * drivers;
    int failed = NAME(products_pull)(weights, every, shapes, members, combinations, most, 0, gradient + shapes + betweens,
                                     gradient_ld, of_shapes, batch);
    for (Index row = 0; row < batch; row++) {
        const REAL *given = gradient + row * gradient_ld, *bumps = bump + row * betweens, *values = limited + row * shapes;
        const REAL *factors = factor + row * shapes, *rates = yield_derivative + row * regions;
        REAL *each = of_shapes + row * shapes;
        for (Index shape = 0; shape < shapes; shape++) each[shape] += given[shape];
        for (Index number = 0; number < betweens; number++) each[between_shape[number]] += given[shapes + number] * bumps[number];
        memset(of_regions, 0, sizeof(REAL) * (size_t)regions);
        for (Index shape = 0; shape < shapes; shape++) of_regions[region[shape]] += each[shape] * values[shape];
        for (Index shape = 0; shape < shapes; shape++)
            each[shape] = each[shape] * factors[shape] + of_regions[region[shape]] * rates[region[shape]] * cost[shape];
        for (Index number = 0; number < ceilings; number++) {
            REAL *close = each + ceiling_shape[number];
            const REAL is_below = below[row * ceilings + number], whole = *close;
            *close = whole * is_below;
            each[ceiling_under[number]] += whole * (1 - is_below) * under_derivative[row * ceilings + number];
        }
    }
    failed |= NAME(products_pull)(driven, drivers, drivers, sources, shapes, slots, 1, of_shapes, shapes, of_drivers, batch);
    memset(pulled, 0, sizeof(REAL) * (size_t)(batch * controls));
    for (Index row = 0; row < batch; row++)
        for (Index driver = 0; driver < drivers; driver++)
            pulled[row * controls + driver_control[driver]] += of_drivers[row * drivers + driver] * rise[row * drivers + driver];
    (void)yielding;
    free(of_shapes);
    return failed;
}

#undef LOGIC
#undef STATE
