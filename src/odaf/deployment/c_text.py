"""Text of the C form that is the same for every policy: its functions, tests and drivers."""

HELPERS = """\
/* Whether a number is finite, by its bits: holds under -ffast-math, which takes every number for finite. */
static inline int policy_finite(float x)
{
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    return (bits & 0x7f800000u) != 0x7f800000u;
}

static inline float policy_unknown(void)
{
    const uint32_t bits = 0x7fc00000u;
    float x;
    memcpy(&x, &bits, sizeof x);
    return x;
}

/* y = x w + b; w [in][out]; b may be NULL. */
static inline void policy_affine(size_t in, size_t out, const float *POLICY_RESTRICT x, const float *POLICY_RESTRICT w,
                                 const float *POLICY_RESTRICT b, float *POLICY_RESTRICT y)
{
    const size_t fours = in - in % 4;
    for (size_t j = 0; j < out; ++j) y[j] = b ? b[j] : 0.0f;
    for (size_t i = 0; i < fours; i += 4) {
        const float x0 = x[i], x1 = x[i + 1], x2 = x[i + 2], x3 = x[i + 3];
        const float *POLICY_RESTRICT w0 = w + i * out, *POLICY_RESTRICT w1 = w0 + out;
        const float *POLICY_RESTRICT w2 = w1 + out, *POLICY_RESTRICT w3 = w2 + out;
        for (size_t j = 0; j < out; ++j) y[j] = y[j] + x0 * w0[j] + x1 * w1[j] + x2 * w2[j] + x3 * w3[j];
    }
    for (size_t i = fours; i < in; ++i)
        for (size_t j = 0; j < out; ++j) y[j] += x[i] * w[i * out + j];
}

/* To mean 0 and variance 1. */
static inline void policy_standardise(size_t width, float epsilon, const float *POLICY_RESTRICT x,
                                      float *POLICY_RESTRICT y)
{
    float mean = 0.0f, square = 0.0f;
    for (size_t k = 0; k < width; ++k) mean += x[k];
    mean /= (float)width;
    for (size_t k = 0; k < width; ++k) square += (x[k] - mean) * (x[k] - mean);
    const float scale = 1.0f / sqrtf(square / (float)width + epsilon);
    for (size_t k = 0; k < width; ++k) y[k] = (x[k] - mean) * scale;
}"""

ONE = """\
/* One plant: its state is kept here. */
static policy_state policy_only;
static int policy_begun;

static inline void policy_begin(void)
{
    policy_begin_state(&policy_only);
    policy_begun = 1;
}

static inline int policy_act(const float *obs, float *act)
{
    if (!policy_begun) policy_begin();
    return policy_step(&policy_only, obs, act);
}"""

ACTED = """\
/* Tells what was played in the last step, where it was not what policy_act gave. If it is not finite, tells nothing and
   returns -1. */
static inline int policy_acted_state(policy_state *s, const float *{of})
{{
    for (size_t k = 0; k < {width}; ++k)
        if (!policy_finite({of}[k])) return -1;
    memcpy(s->{carry}, {of}, {width} * sizeof(float));
    return 0;
}}

static inline int policy_acted(const float *act)
{{
    return policy_acted_state(&policy_only, act);
}}"""

TEST = """\
/*
 * Checks policy.h on the machine that it is to run on, with the compiler and the options that it is compiled with:
 *
 *     cc -std=c99 -O3 policy_test.c -lm -o policy_test && ./policy_test
 */
#include <stdio.h>

#include "policy.h"

static const float tolerance[] = {{{tolerance}}};
static const struct {{
    int begin, status, told;
    float observation[{columns}], action[{actions}], played[{actions}];
}} vectors[] = {{
{vectors}
}};

int main(void)
{{
    const size_t count = sizeof vectors / sizeof *vectors;
    int wrong = 0;
    float largest = 0.0f, act[{actions}];
    for (size_t n = 0; n < count; ++n) {{
        if (vectors[n].begin) policy_begin();
        const int status = policy_act(vectors[n].observation, act);
        if (status != vectors[n].status) {{
            printf("vector %d: status %d, expected %d\\n", (int)n, status, vectors[n].status);
            ++wrong;
        }}
        for (int k = 0; (status == 0 || status == 4) && k < {actions}; ++k) {{
            const float off = fabsf(act[k] - vectors[n].action[k]) / tolerance[k];
            if (off > largest) largest = off;
            if (!(off <= 1.0f)) {{
                printf("vector %d: action %d is %.9g, expected %.9g\\n", (int)n, k, act[k], vectors[n].action[k]);
                ++wrong;
            }}
        }}
{acted}    }}
    for (int k = 0; k < {columns}; ++k) {{
        float broken[{columns}];
        memcpy(broken, vectors[0].observation, sizeof broken);
        broken[k] = policy_unknown();
        if (policy_act(broken, act) != 1 || policy_finite(act[0])) {{
            printf("a NaN in column %d is not refused\\n", k);
            ++wrong;
        }}
    }}
    printf("%d vectors, largest difference %.3g of what is allowed: %s\\n", (int)count, largest,
           wrong ? "WRONG" : "fine");
    return wrong != 0;
}}
"""

DRIVER = """\
#include <stdio.h>
#include "policy.h"
#define COLUMNS POLICY_OBSERVATIONS
#define ACTIONS POLICY_ACTIONS
int main(void)
{
    float given[1 + COLUMNS + ACTIONS], answer[1 + ACTIONS];
    while (fread(given, sizeof given, 1, stdin) == 1) {
        if (given[0] != 0.0f) policy_begin();
        answer[0] = (float)policy_act(given + 1, answer + 1);
        if (policy_finite(given[1 + COLUMNS])) %(acted)s;
        fwrite(answer, sizeof answer, 1, stdout);
    }
    return 0;
}
"""
