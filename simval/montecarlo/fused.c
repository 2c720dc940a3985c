/* Trials of the two-vector closed form in one pass: draw, estimate, average.

   The NumPy form of every step is in simval/montecarlo/fused.py, equal to
   the bit: here as there a number is made by IEEE additions, multiplications, divisions
   and square roots in one fixed order, so neither the width of a vector register nor the
   compiler's version changes a bit. Contraction to fused multiply-adds is off
   (CMakeLists.txt), and fused.py uses this block only if it reproduces a batch.

   Random numbers: LANES independent streams of SFC64 (C. Doty-Humphrey), stepped side by
   side; normals by Box and Muller's transform. */

#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <float.h>
#include <math.h>
#include <stdint.h>
#include <string.h>

/* 16: half floats are computed as such, so doubles as doubles */
#if defined(__FAST_MATH__) || (FLT_EVAL_METHOD != 0 && FLT_EVAL_METHOD != 16)
#error "doubles must be computed as IEEE doubles: without this block NumPy does the same"
#endif

#define LANES 64     /* streams */
#define WARM 12      /* steps of a fresh stream that are thrown away */
#define BATCH 256    /* trials */
#define NORMALS 9    /* of a trial */
#define PAIRS (NORMALS * BATCH / 2)
#define FEATURES 14  /* four errors and their ten products */
#define SUMS 8       /* partial sums of a batch */
#define ONE 0x3ff0000000000000u  /* the bits of 1.0 */
#define SIGN 0x8000000000000000u

#ifndef ANY_WIDTH
#if defined(__GNUC__) && defined(__x86_64__) && defined(__GLIBC__)
#define ANY_WIDTH __attribute__((target_clones("default", "avx2", "avx512f")))
#else
#define ANY_WIDTH
#endif
#endif

typedef struct { uint64_t a[LANES], b[LANES], c[LANES], count[LANES]; } Streams;

static inline double as_double(uint64_t bits)
{
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static inline uint64_t as_bits(double value)
{
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

ANY_WIDTH
static void draw(Streams *restrict s, uint64_t *restrict out, int steps)
{
    for (int t = 0; t < steps; t++)
        for (int l = 0; l < LANES; l++) {
            uint64_t next = s->a[l] + s->b[l] + s->count[l];
            s->count[l] += 1;
            s->a[l] = s->b[l] ^ (s->b[l] >> 11);
            s->b[l] = s->c[l] + (s->c[l] << 3);
            s->c[l] = ((s->c[l] << 24) | (s->c[l] >> 40)) + next;
            out[t * LANES + l] = next;
        }
}

/* sqrt(-2 ln u) for u in (0, 1] by steps of 2^-52. A series is summed as a polynomial of
   even and one of odd powers, which run side by side; what it leaves out is below 2^-53. */
ANY_WIDTH
static void radii(const uint64_t *restrict bits, double *restrict out, int count)
{
    for (int i = 0; i < count; i++) {
        double u = 2.0 - as_double((bits[i] >> 12) | ONE);
        /* u = 2^k f with f from sqrt(1/2) to sqrt(2) */
        uint64_t e = (as_bits(u) - 0x3fe6a09e667f3bcdu + ONE) >> 52; /* k + 1023 */
        double k = as_double(e | 0x4330000000000000u) - 4503599627371519.0;
        double f = as_double(as_bits(u) - (e << 52) + ONE);
        double s = (f - 1.0) / (f + 1.0), z = s * s, zz = z * z;
        double even = 1.0 / 19.0, odd = 1.0 / 17.0;
        even = even * zz + 1.0 / 15.0;
        even = even * zz + 1.0 / 11.0;
        even = even * zz + 1.0 / 7.0;
        even = even * zz + 1.0 / 3.0;
        odd = odd * zz + 1.0 / 13.0;
        odd = odd * zz + 1.0 / 9.0;
        odd = odd * zz + 1.0 / 5.0;
        double log_f = 2.0 * (s + s * (z * (even + z * odd)));
        out[i] = sqrt(-2.0 * (k * 0.6931471805599453 + log_f));
    }
}

/* Radii times cosines, in their place, and times sines: an angle of 52 bits within an
   octant, and three bits that say which. */
ANY_WIDTH
static void turn(const uint64_t *restrict bits, double *restrict radii,
                 double *restrict sines, int count)
{
    for (int i = 0; i < count; i++) {
        uint64_t angle = bits[i];
        double x = (as_double(((angle << 3) >> 12) | ONE) - 1.0) * 0.7853981633974483;
        double y = x * x, yy = y * y;
        double even = -1.0 / 1307674368000.0, odd = 1.0 / 6227020800.0;
        even = even * yy - 1.0 / 39916800.0;
        even = even * yy - 1.0 / 5040.0;
        even = even * yy - 1.0 / 6.0;
        odd = odd * yy + 1.0 / 362880.0;
        odd = odd * yy + 1.0 / 120.0;
        uint64_t sine = as_bits(x + x * (y * (even + y * odd)));
        even = -1.0 / 87178291200.0;
        even = even * yy - 1.0 / 3628800.0;
        even = even * yy - 1.0 / 720.0;
        even = even * yy - 0.5;
        odd = 1.0 / 20922789888000.0;
        odd = odd * yy + 1.0 / 479001600.0;
        odd = odd * yy + 1.0 / 40320.0;
        odd = odd * yy + 1.0 / 24.0;
        uint64_t cosine = as_bits(1.0 + y * (even + y * odd));
        uint64_t change = (cosine ^ sine) & (0 - (angle >> 63));
        cosine = (cosine ^ change) ^ ((angle << 1) & SIGN);
        sine = (sine ^ change) ^ ((angle << 2) & SIGN);
        sines[i] = radii[i] * as_double(sine);
        radii[i] = radii[i] * as_double(cosine);
    }
}

/* Means over a batch of q - (d1 x d2; s1 . d2), normalised, and of its products. */
ANY_WIDTH
static void average(const double *restrict x, const double *restrict mean,
                    double noise, const double *restrict q, double *restrict out)
{
    double sums[FEATURES][SUMS];
    memset(sums, 0, sizeof sums);
    for (int t = 0; t < BATCH; t += SUMS) {
        double e[4][SUMS];
        for (int l = 0; l < SUMS; l++) {
            double v[NORMALS];
            for (int j = 0; j < NORMALS; j++)
                v[j] = mean[j] + noise * x[j * BATCH + t + l];
            double w0 = v[1] * v[8] - v[2] * v[7];
            double w1 = v[2] * v[6] - v[0] * v[8];
            double w2 = v[0] * v[7] - v[1] * v[6];
            double w3 = v[3] * v[6] + v[4] * v[7] + v[5] * v[8];
            double n = 1.0 / sqrt(w0 * w0 + w1 * w1 + w2 * w2 + w3 * w3);
            e[0][l] = q[0] - w0 * n;
            e[1][l] = q[1] - w1 * n;
            e[2][l] = q[2] - w2 * n;
            e[3][l] = q[3] - w3 * n;
        }
        for (int i = 0, m = 4; i < 4; i++) {
            for (int l = 0; l < SUMS; l++)
                sums[i][l] += e[i][l];
            for (int j = i; j < 4; j++, m++)
                for (int l = 0; l < SUMS; l++)
                    sums[m][l] += e[i][l] * e[j][l];
        }
    }
    for (int m = 0; m < FEATURES; m++) {
        const double *s = sums[m];
        out[m] = (((s[0] + s[4]) + (s[2] + s[6])) + ((s[1] + s[5]) + (s[3] + s[7])))
                 / BATCH;
    }
}

/* Batch means of `count` batches. The arguments are copied, so they need no alignment and
   may overlap. */
static void run(void *state, const void *mean, double noise, const void *q, char *out,
                Py_ssize_t count)
{
    Streams streams;
    double m[NORMALS], r[4], x[NORMALS * BATCH], means[FEATURES];
    uint64_t bits[NORMALS * BATCH];
    memcpy(&streams, state, sizeof streams);
    memcpy(m, mean, sizeof m);
    memcpy(r, q, sizeof r);
    draw(&streams, bits, WARM);
    for (Py_ssize_t b = 0; b < count; b++) {
        draw(&streams, bits, NORMALS * BATCH / LANES);
        radii(bits, x, PAIRS);
        turn(bits + PAIRS, x, x + PAIRS, PAIRS);
        average(x, m, noise, r, means);
        memcpy(out + (size_t)b * sizeof means, means, sizeof means);
    }
    memcpy(state, &streams, sizeof streams);
}

/* A C-contiguous buffer of doubles ('d') or unsigned 64-bit integers ('L'), as many as
   `count`, or any multiple of it that is not 0; or an error. */
static int take(PyObject *object, Py_buffer *view, const char *name, char format,
                Py_ssize_t count, int several, int writable)
{
    int flags = PyBUF_C_CONTIGUOUS | PyBUF_FORMAT | (writable ? PyBUF_WRITABLE : 0);
    if (PyObject_GetBuffer(object, view, flags) < 0)
        return -1;
    char found = view->format == NULL ? '\0' : view->format[0];
    int right = view->itemsize == 8 && (found == format || (format == 'L' && found == 'Q'));
    Py_ssize_t size = count * 8;
    if (!right || view->len < size || view->len % size || (!several && view->len > size)) {
        PyErr_Format(PyExc_ValueError, "`%s` has %zd bytes of format '%s'; give %s%zd "
                     "numbers of format '%c'", name, view->len,
                     view->format == NULL ? "" : view->format,
                     several ? "a multiple of " : "", count, format);
        PyBuffer_Release(view);
        return -1;
    }
    return 0;
}

PyDoc_STRVAR(batches_doc,
"batches(state, mean, noise, q, out)\n--\n\n"
"Batch means of a block of trials, into `out`, by fresh streams `state`, which move on.");

static PyObject *batches(PyObject *module, PyObject *args)
{
    PyObject *objects[4];
    Py_buffer state, mean, q, out;
    double noise;
    (void)module;
    if (!PyArg_ParseTuple(args, "OOdOO", &objects[0], &objects[1], &noise, &objects[2],
                          &objects[3]))
        return NULL;
    if (take(objects[0], &state, "state", 'L', 4 * LANES, 0, 1) < 0)
        return NULL;
    if (take(objects[1], &mean, "mean", 'd', NORMALS, 0, 0) < 0)
        goto no_mean;
    if (take(objects[2], &q, "q", 'd', 4, 0, 0) < 0)
        goto no_q;
    if (take(objects[3], &out, "out", 'd', FEATURES, 1, 1) < 0)
        goto no_out;
    Py_BEGIN_ALLOW_THREADS
    run(state.buf, mean.buf, noise, q.buf, out.buf, out.len / (8 * FEATURES));
    Py_END_ALLOW_THREADS
    PyBuffer_Release(&out);
no_out:
    PyBuffer_Release(&q);
no_q:
    PyBuffer_Release(&mean);
no_mean:
    PyBuffer_Release(&state);
    if (PyErr_Occurred())
        return NULL;
    Py_RETURN_NONE;
}

static PyMethodDef methods[] = {
    {"batches", batches, METH_VARARGS, batches_doc},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "_simval_fused", NULL, 0, methods, NULL, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__simval_fused(void)
{
    return PyModule_Create(&definition);
}
