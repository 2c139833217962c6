static struct { int32_t a[1000], b[1000]; int16_t i; int32_t seed, sum; int64_t result; } s = { .seed = 1 };
void SCAN(int64_t now) {
  s.sum = 0;
  for (s.i = 0; s.i <= 999; s.i++) {
    s.seed = (int32_t)((uint32_t)s.seed * 1103515245u + 12345u);
    s.a[s.i] = (int32_t)((uint32_t)s.b[s.i] + (uint32_t)(s.seed / 65536));
  }
  for (s.i = 1; s.i <= 999; s.i++) {
    s.b[s.i] = (int32_t)((uint32_t)s.a[s.i] + (uint32_t)s.a[s.i - 1]) / 2;
    s.sum = (int32_t)((uint32_t)s.sum + (uint32_t)s.b[s.i]);
  }
  s.result = s.sum;
}
double RESULT(void) { return (double)s.result; }
