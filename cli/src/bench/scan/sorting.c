static struct { int16_t a[64], i, j, t; int32_t seed; int64_t result; } s = { .seed = 7 };
void SCAN(int64_t now) {
  for (s.i = 0; s.i <= 63; s.i++) { s.seed = (s.seed * 4093 + 577) % 32749; s.a[s.i] = (int16_t)s.seed; }
  for (s.i = 1; s.i <= 63; s.i++) {
    s.t = s.a[s.i]; s.j = s.i - 1;
    while (s.j >= 0) { if (s.a[s.j] <= s.t) break; s.a[s.j + 1] = s.a[s.j]; s.j--; }
    s.a[s.j + 1] = s.t;
  }
  s.result = (int64_t)s.a[0] * 3 + (int16_t)(s.a[32] * 5) + s.a[63];
}
double RESULT(void) { return (double)s.result; }
