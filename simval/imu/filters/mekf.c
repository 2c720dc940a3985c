/* Rows of the filter of simval/imu/filters/mekf.py, eqs. (F9) to (F11), in one call.

   The NumPy form there is the definition, equal to rounding; mekf.py uses this form only
   if it reproduces some rows. P is symmetric, and its blocks of 3 by 3 are taken apart
   where F and H have zeros. Contraction to fused multiply-adds is off (CMakeLists.txt),
   so that a compiler changes no bit; sines and cosines are those of the C library. */

#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <math.h>
#include <string.h>

#define TINY 1e-100 /* rad, stands in for no turn */

typedef struct {
    int sensors;
    const double *references, *R; /* (sensors, 3) and (3 sensors,) */
    double N2, K2, coning;
} Filter;

typedef struct {
    double q[4], b[3], before[3], P[6][6];
} State;

static void cross(const double *a, const double *b, double *out)
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

static void skew(const double *v, double X[3][3])
{
    double found[3][3] = {{0.0, -v[2], v[1]}, {v[2], 0.0, -v[0]}, {-v[1], v[0], 0.0}};
    memcpy(X, found, sizeof found);
}

/* q * q(turn), of length 1 again */
static void turned(double *q, const double *turn)
{
    double squared = turn[0] * turn[0] + turn[1] * turn[1] + turn[2] * turn[2];
    double half = fmax(sqrt(squared) / 2.0, TINY);
    double k = sin(half) / half / 2.0, s = cos(half), c[3], made[4];
    double e[3] = {k * turn[0], k * turn[1], k * turn[2]};
    cross(q, e, c);
    for (int i = 0; i < 3; i++)
        made[i] = q[3] * e[i] + s * q[i] + c[i];
    made[3] = q[3] * s - (q[0] * e[0] + q[1] * e[1] + q[2] * e[2]);
    double length = sqrt(made[0] * made[0] + made[1] * made[1] + made[2] * made[2]
                         + made[3] * made[3]);
    for (int i = 0; i < 4; i++)
        q[i] = made[i] / length;
}

/* A(q) v = v - 2 s (e x v) + 2 e x (e x v) */
static void rotated(const double *q, const double *v, double *out)
{
    double once[3], twice[3];
    cross(q, v, once);
    cross(q, once, twice);
    for (int i = 0; i < 3; i++)
        out[i] = v[i] - 2.0 * (q[3] * once[i] - twice[i]);
}

/* Eqs. (F9) and (F10): with the blocks F and G of the transition, [F G; 0 I]. */
static void step(const Filter *filter, State *state, double h, const double *rate)
{
    double S[3], phi[3], cone[3], X[3][3], F[3][3], G[3][3], A[3][3], B[3][3];
    for (int i = 0; i < 3; i++)
        S[i] = phi[i] = h * (rate[i] - state->b[i]);
    if (filter->coning != 0.0) {
        cross(state->before, S, cone);
        for (int i = 0; i < 3; i++)
            phi[i] += cone[i] / 12.0;
    }
    memcpy(state->before, S, sizeof S);
    turned(state->q, phi);

    double square = phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2];
    double angle = fmax(sqrt(square), TINY), sinc = sin(angle) / angle;
    double root = sin(angle / 2.0) / angle, half = 2.0 * root * root;
    double rest = square < 1e-4 ? 1.0 / 6.0 - square / 120.0 : (1.0 - sinc) / square;
    skew(phi, X);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            double one = i == j, XX = phi[i] * phi[j] - one * square;
            F[i][j] = one - sinc * X[i][j] + half * XX;
            G[i][j] = -h * (one - half * X[i][j] + rest * XX);
        }

    double(*P)[6] = state->P;
    for (int i = 0; i < 3; i++) /* [A B] = [F G] P */
        for (int j = 0; j < 3; j++) {
            A[i][j] = B[i][j] = 0.0;
            for (int k = 0; k < 3; k++) {
                A[i][j] += F[i][k] * P[k][j] + G[i][k] * P[k + 3][j];
                B[i][j] += F[i][k] * P[k][j + 3] + G[i][k] * P[k + 3][j + 3];
            }
        }
    double N2 = filter->N2, K2 = filter->K2;
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            double sum = 0.0;
            for (int k = 0; k < 3; k++)
                sum += A[i][k] * F[j][k] + B[i][k] * G[j][k];
            P[i][j] = sum;
            P[i][j + 3] = P[j + 3][i] = B[i][j];
        }
        P[i][i] += N2 * h + K2 * h * h * h / 3.0;
        P[i + 3][i + 3] += K2 * h;
        P[i][i + 3] -= K2 * h * h / 2.0;
        P[i + 3][i] = P[i][i + 3];
    }
}

/* Eq. (F11), by the Cholesky factor L of the innovation's covariance C: with W = L^-1 H P
   and u = L^-1 z the estimate moves by W' u, and P loses W' W. */
static void correct(const Filter *filter, State *state, const double *const *readings,
                    double *innovation, double *covariance)
{
    int m = 3 * filter->sensors;
    double z[6], H[6][3], HP[6][6], C[6][6], L[6][6], W[6][6], u[6], moved[6] = {0.0};
    double(*P)[6] = state->P;
    for (int k = 0; k < filter->sensors; k++) {
        double v[3];
        rotated(state->q, filter->references + 3 * k, v);
        skew(v, H + 3 * k);
        for (int i = 0; i < 3; i++)
            z[3 * k + i] = readings[k][i] - v[i];
    }
    for (int i = 0; i < m; i++)
        for (int j = 0; j < 6; j++)
            HP[i][j] = H[i][0] * P[0][j] + H[i][1] * P[1][j] + H[i][2] * P[2][j];
    for (int i = 0; i < m; i++)
        for (int j = 0; j <= i; j++) {
            C[i][j] = HP[i][0] * H[j][0] + HP[i][1] * H[j][1] + HP[i][2] * H[j][2];
            C[i][j] += i == j ? filter->R[i] : 0.0;
            C[j][i] = C[i][j];
        }
    for (int i = 0; i < m; i++) {
        for (int j = 0; j <= i; j++) {
            double left = C[i][j];
            for (int k = 0; k < j; k++)
                left -= L[i][k] * L[j][k];
            L[i][j] = i == j ? sqrt(left) : left / L[j][j];
        }
        u[i] = z[i];
        memcpy(W[i], HP[i], sizeof W[i]);
        for (int k = 0; k < i; k++) {
            u[i] -= L[i][k] * u[k];
            for (int j = 0; j < 6; j++)
                W[i][j] -= L[i][k] * W[k][j];
        }
        u[i] /= L[i][i];
        for (int j = 0; j < 6; j++) {
            W[i][j] /= L[i][i];
            moved[j] += W[i][j] * u[i];
        }
    }
    for (int i = 0; i < 6; i++)
        for (int j = i; j < 6; j++) {
            double lost = 0.0;
            for (int k = 0; k < m; k++)
                lost += W[k][i] * W[k][j];
            P[i][j] = P[j][i] = P[i][j] - lost;
        }
    turned(state->q, moved);
    for (int i = 0; i < 3; i++)
        state->b[i] += moved[3 + i];
    memcpy(innovation, z, m * sizeof *z);
    for (int i = 0; i < m; i++)
        memcpy(covariance + m * i, C[i], m * sizeof **C);
}

/* Arguments. `told` is references, R, N2, K2 and coning; a row of `answers` is attitude,
   bias, covariance, innovation and its covariance; a state is laid out as `State`. */
enum { DT, GYROSCOPE, ACCELEROMETER, MAGNETOMETER, TOLD, STATE, ANSWERS, ARRAYS };
static const char *const NAMES[ARRAYS] = {
    "dt", "gyroscope", "accelerometer", "magnetometer", "told", "state", "answers"};
#define DOUBLES (sizeof(State) / sizeof(double))

static void run(double *const *given, Py_ssize_t rows, Py_ssize_t trials, int sensors)
{
    int m = 3 * sensors, width = 43 + m + m * m;
    const double *told = given[TOLD] + m;
    Filter filter = {sensors, given[TOLD], told, told[m], told[m + 1], told[m + 2]};
    for (Py_ssize_t row = 0; row < rows; row++)
        for (Py_ssize_t trial = 0; trial < trials; trial++) {
            Py_ssize_t at = row * trials + trial;
            State *state = (State *)(given[STATE] + DOUBLES * trial);
            double *answer = given[ANSWERS] + width * at;
            const double *readings[2];
            int count = 0;
            for (int sensor = ACCELEROMETER; sensor <= MAGNETOMETER; sensor++)
                if (given[sensor] != NULL)
                    readings[count++] = given[sensor] + 3 * at;
            step(&filter, state, given[DT][row], given[GYROSCOPE] + 3 * at);
            correct(&filter, state, readings, answer + 43, answer + 43 + m);
            memcpy(answer, state->q, sizeof state->q);
            memcpy(answer + 4, state->b, sizeof state->b);
            memcpy(answer + 7, state->P, sizeof state->P);
        }
}

/* Of this machine's doubles, whether or not the format states their byte order. */
static int of_doubles(const Py_buffer *view)
{
    const char *format = view->format == NULL ? "" : view->format;
    if (*format == '@' || *format == '=' || *format == (PY_LITTLE_ENDIAN ? '<' : '>'))
        format++;
    return strcmp(format, "d") == 0 && view->itemsize == sizeof(double);
}

PyDoc_STRVAR(rows_doc,
"rows(dt, gyroscope, accelerometer, magnetometer, told, state, answers)\n--\n\n"
"Step through rows: C-contiguous doubles, and None for a sensor that is not there; the\n"
"state and the answers are written in place.");

static PyObject *rows(PyObject *module, PyObject *args)
{
    PyObject *objects[ARRAYS], *answer = NULL;
    Py_buffer views[ARRAYS];
    double *given[ARRAYS] = {NULL};
    int sensors = 0;
    (void)module;
    memset(views, 0, sizeof views); /* what is not there is released as nothing */
    if (!PyArg_UnpackTuple(args, "rows", ARRAYS, ARRAYS, &objects[0], &objects[1],
                           &objects[2], &objects[3], &objects[4], &objects[5],
                           &objects[6]))
        return NULL;
    for (int i = 0; i < ARRAYS; i++) {
        int sensor = i == ACCELEROMETER || i == MAGNETOMETER;
        int flags = PyBUF_C_CONTIGUOUS | PyBUF_FORMAT;
        if (sensor && objects[i] == Py_None)
            continue;
        if (PyObject_GetBuffer(objects[i], &views[i],
                               flags | (i >= STATE ? PyBUF_WRITABLE : 0)) < 0)
            goto done;
        if (!of_doubles(&views[i])) {
            PyErr_Format(PyExc_ValueError, "`%s` must be of doubles", NAMES[i]);
            goto done;
        }
        given[i] = views[i].buf;
        sensors += sensor;
    }
    Py_ssize_t count = views[DT].len / 8, trials = views[STATE].len / sizeof(State);
    Py_ssize_t each = count * trials, m = 3 * sensors;
    Py_ssize_t sizes[ARRAYS] = {count, 3 * each, 3 * each, 3 * each, 2 * m + 3,
                                (Py_ssize_t)DOUBLES * trials, (43 + m + m * m) * each};
    for (int i = 0; i < ARRAYS; i++)
        if (views[i].obj != NULL && views[i].len != 8 * sizes[i]) {
            PyErr_Format(PyExc_ValueError, "`%s` has %zd numbers; %zd are needed",
                         NAMES[i], views[i].len / 8, sizes[i]);
            goto done;
        }
    Py_BEGIN_ALLOW_THREADS
    run(given, count, trials, sensors);
    Py_END_ALLOW_THREADS
    answer = Py_NewRef(Py_None);
done:
    for (int i = 0; i < ARRAYS; i++)
        PyBuffer_Release(&views[i]);
    return answer;
}

static PyMethodDef methods[] = {
    {"rows", rows, METH_VARARGS, rows_doc},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "_simval_mekf", NULL, 0, methods, NULL, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__simval_mekf(void)
{
    return PyModule_Create(&definition);
}
