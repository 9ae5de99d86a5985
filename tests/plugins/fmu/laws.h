/* Laws for tests of FMUs; the parameter `gain` chooses one. */
static int steps = 0; /* of the library, whatever its instances: a bad habit that FMUs have */

static int law(Model *model, double time, double step) {
    double *v = model->values;
    int chosen = (int)v[GAIN];
    if (chosen < 0) { /* an echo of the values */
        v[STEERING] = v[-chosen - 1];
        return OK;
    }
    switch (chosen) {
    case 0: /* counts */
        steps++;
        v[STEERING] = 0.001 * steps;
        return OK;
    case 1:
        say(model, ERROR, "the matrix is singular");
        return ERROR;
    case 2:
        say(model, WARNING, "the filter diverges");
        v[STEERING] = NAN;
        return OK;
    case 3:
        abort();
    case 4:
        for (;;) {
        }
    case 5:
        return DISCARD;
    case 6:
        return FATAL;
    case 7: /* times in ms */
        v[STEERING] = 1000.0 * time + step;
        return OK;
    default:
        v[STEERING] = INFINITY;
        return OK;
    }
}
