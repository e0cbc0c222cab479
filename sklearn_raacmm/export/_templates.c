C99 source with places for names and sizes: `Tables.c` in _c_files.py fills them.

//// max
static inline $real larger($real a, $real b)
{
    return a < b ? b : a; /* NaN if a is */
}
//// min
static inline $real smaller($real a, $real b)
{
    return b < a ? b : a; /* NaN if a is */
}
//// less
static inline $real less($real a, $real b)
{
    return a < b ? 1 : 0;
}
//// all_finite
/* 0 for NaN and infinity, too. */
static int all_finite(const $real *v, int n)
{
    for (int i = 0; i < n; ++i)
        if (!(v[i] >= -$most && v[i] <= $most))
            return 0;
    return 1;
}
//// frames
for (int i = 0; i < 12; ++i)
    $v[i] = i % 4 == 0 && i < 9 ? 1 : 0;
for (int i = 0; i < $n; ++i) {
    const $real *dh = $table[i], *from = $v + 12 * i;
    const $real c = cos$f($theta[i]), s = sin$f($theta[i]);
    $real *to = $v + 12 * i + 12;
    for (int k = 0; k < 3; ++k) {
        const $real x0 = from[k], y0 = from[3 + k], z0 = from[6 + k];
$turn
    }
}
//// standard
        const $real x = c * x0 + s * y0, y = c * y0 - s * x0;
        to[k] = x;
        to[3 + k] = dh[0] * y + dh[1] * z0;
        to[6 + k] = dh[0] * z0 - dh[1] * y;
        to[9 + k] = from[9 + k] + dh[3] * z0 + dh[2] * x;
//// modified
        const $real y = dh[0] * y0 + dh[1] * z0, z = dh[0] * z0 - dh[1] * y0;
        to[k] = c * x0 + s * y;
        to[3 + k] = c * y - s * x0;
        to[6 + k] = z;
        to[9 + k] = from[9 + k] + dh[2] * x0 + dh[3] * z;
//// sum
$real sum = 0;
for (int j = 0; j < $n; ++j)
    sum += $term;
$result = sum;
//// long_sum
$real part[$width] = {0}, sum = 0;
for (int k = 0; k < $full; k += $width)
    for (int j = 0; j < $width; ++j)
        part[j] += $part;
for (int j = 0; j < $width; ++j)
    sum += part[j];
$rest
$result = sum;
//// sum_rest
for (int j = $full; j < $n; ++j)
    sum += $term;
//// columns
{
    const $real *row = $table;
    for (int c = 0; c < $columns; ++c) {
        $length
        for (int i = 0; i < n; ++i)
            $v[i] += row[i] * $x[c];
        row += n;
    }
}
//// sparse
for (int i = 0; i < $rows; ++i) {
    $real sum = $first;
    for (int e = $start[i]; e < $start[i + 1]; ++e)
        sum += $values[e] * $x[$of[e]];
    $v[i] = sum;
}
//// waves
{
    $real power[$size] = {1, 0}; /* cosines and sines by turns */
    for (int i = 0; i < $n_firsts; ++i) {
        power[2 * i + 2] = cos$f($angles[$first[i]]);
        power[2 * i + 3] = sin$f($angles[$first[i]]);
    }
$products
    for (int i = 0; i < $n; ++i)
        $v[i] = power[$at[i]];
}
//// products
    for (int i = 0; i < $n; ++i) {
        const $real *a = power + $of[i][0], *b = power + $of[i][1];
        $real *c = power + 2 * i + $start;
        c[0] = a[0] * b[0] - a[1] * b[1];
        c[1] = a[0] * b[1] + a[1] * b[0];
    }
//// distances
for (int i = 0; i < $d; ++i) {
    const $real z = ($x[i] - $shift[i]) * $width[i];
    for (int c = 0; c < $k; ++c)
        $v[c] += (z - $center[i][c]) * (z - $center[i][c]);
}
/* squared, in units of the length scales */
for (int c = 0; c < $k; ++c)
    $v[c] = $v[c] > $most ? $most : $v[c];
//// variances
{
    $kind dot[3][$r] = {{0}};
    const $stored *row = $root;
    for (int c = 0; c < $m;) {
        const int a = $vector[c];
        $kind shared[$r] = {0};
        int filled = 0;
        do {
            $length
            const $kind size = ($kind)$sizes[c];
            for (int i = 0; i < n; ++i)
                shared[i] += size * row[i];
            filled = n;
            row += n;
            ++c;
        } while (c < $m && $vector[c] == a);
        for (int k = 0; k < 3; ++k) {
            const $kind along = ($kind)$vectors[$axes * k + a];
            for (int i = 0; i < filled; ++i)
                dot[k][i] += along * shared[i];
        }
    }
    for (int k = 0; k < 3; ++k) {
        $kind sum = 0;
        for (int i = 0; i < $more; ++i)
            sum += dot[k][i] * dot[k][i];
$less
        $v[k] = sum;
    }
}
//// taken_off
        for (int i = $more; i < $r; ++i)
            sum -= dot[k][i] * dot[k][i];
//// function
/* 0: fine, 1: faded, 2: not finite. */
static int $name(const $real input[$n], $outputs)
{
$body
}
//// many
int status = 0;
for (size_t i = 0; i < n; ++i) {
    const int one = ${function}($x + i * $n, $out + i * $q);
    status = one > status ? one : status;
}
return status;
//// comments
= predict: What the model predicts from $x.
= correct: How far off the probe is, in the base frame, mm: subtract it from the measured
   point. Joint angles in $unit, as the encoders give them$then.
= status: Returns ${upper}_OK, or ${upper}_NOT_FINITE where all are NaN: an input
   is NaN or infinite, or the model is not defined there.
= faded:  ${upper}_FADED: the model
   is less certain of this pose than the residuals that it was fitted on are large.
= rows: The same for n rows of $n numbers, one after the other; $out has n rows of $q.
   Returns the largest status of a row.
= point: The corrected centre of the probe in the base frame, mm; status and NaN as above.
= trust: The share of the correction that the fading leaves, of its stages the smallest: 1 where
   the model knows the pose, 0 far away, NaN as above.
= std: The same with its standard deviation, as predict(return_std=True) gives it: it grows
   away from the poses that the model was fitted on.
= deviations:  It is of a coordinate within a
   position. Where ${upper}_SCALE_SD is defined, one reading has, in mm:
   within a position w = ${upper}_STD_FACTOR * hypot(std_mm, ${upper}_NOISE_MM);
   of a coordinate in the base frame at least hypot(w, ${upper}_SCALE_SD * (P - S)),
   P the point and S the shoulder;
   of a distance L the root of w^2 of both ends along it and (${upper}_SCALE_SD * L)^2.
= fingerprint: SHA-256 of what the model computes: the same for the same model.
//// header
/* $stem.h
$banner */
#ifndef $guard
#define $guard

#include <stddef.h>

${macros}#define $pair 1 /* $stem.c asks for it */

#ifdef __cplusplus
extern "C" {
#endif

${declared}#ifdef __cplusplus
}
#endif

#endif
//// source
/* $stem.c
$banner *
 * C99, needs the mathematical library alone; no memory is allocated and nothing static
 * changes, so every function may be called from any thread.
 */
#include "$stem.h"

#include <math.h>

#ifndef $pair
#error "$stem.c and $stem.h are of different exports: copy both files of one export."
#endif
#ifdef __FAST_MATH__
#error "-ffast-math takes away the NaN that stands for a refusal: compile without it."
#endif

$text
$defined
//// test
/* ${stem}_test.c: compares $stem.c with what predict gave in Python, at $n rows.
   $command */
#include "$stem.h"

#include <math.h>
#include <stdio.h>

$tables
int main(void)
{
    $real largest = 0;
    int wrong = 0;
    for (int i = 0; i < $n; ++i) {
        $real row[$d], got[$q];
        for (int j = 0; j < $d; ++j)
            row[j] = input_kind[i][j] == 0 ? input[i][j]
                : input_kind[i][j] == 1 ? ($real)NAN
                : input_kind[i][j] == 2 ? ($real)INFINITY : -($real)INFINITY;
        const int status = ${name}_$verb(row, got);
        for (int k = 0; k < $q; ++k) {
            const $real gap = fabs$f(got[k] - expected[i][k]);
            if (refused[i] ? !isnan(got[k]) || status != ${upper}_NOT_FINITE
                           : !(gap <= tolerance) || status == ${upper}_NOT_FINITE) {
                printf("row %d, output %d: got %.17g, expected %.17g, status %d\n", i, k,
                    (double)got[k], (double)expected[i][k], status);
                ++wrong;
            }
            if (!refused[i] && gap > largest)
                largest = gap;
        }
    }
    printf("$name: %d of %d numbers differ too much; the largest gap is %.3g.\n", wrong, $total,
        (double)largest);
    return wrong != 0;
}
