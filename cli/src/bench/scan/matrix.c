static struct { double a[20][20], b[20][20], c[20][20]; int16_t i, j, k; double sum; int32_t n; double result; } s;
void SCAN(int64_t now) {
  s.n++;
  for (s.i = 1; s.i <= 20; s.i++) for (s.j = 1; s.j <= 20; s.j++) {
    s.a[s.i - 1][s.j - 1] = s.i + 0.5; s.b[s.i - 1][s.j - 1] = s.j - 0.25;
  }
  for (s.i = 1; s.i <= 20; s.i++) for (s.j = 1; s.j <= 20; s.j++) {
    s.sum = 0;
    for (s.k = 1; s.k <= 20; s.k++) s.sum = s.sum + s.a[s.i - 1][s.k - 1] * s.b[s.k - 1][s.j - 1];
    s.c[s.i - 1][s.j - 1] = s.sum;
  }
  s.result = s.c[19][19] + s.c[0][6];
}
double RESULT(void) { return s.result; }
