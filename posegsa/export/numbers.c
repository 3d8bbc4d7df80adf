#ifndef POSEGSA_REAL
#define POSEGSA_REAL double
#endif

typedef POSEGSA_REAL posegsa_real;

#define POSEGSA_C(number) ((posegsa_real)(number))

static inline posegsa_real posegsa_min(posegsa_real x, posegsa_real y)
{
    return x < y ? x : y;
}

static inline posegsa_real posegsa_max(posegsa_real x, posegsa_real y)
{
    return x > y ? x : y;
}
