static struct { double x, y; int16_t i; double result; } s = { 0.1, 0, 0, 0 };
void SCAN(int64_t now) {
  s.y = 0;
  for (s.i = 1; s.i <= 20; s.i++) {
    s.x += 0.01; if (s.x > 6.0) s.x = 0.1;
    s.y = s.y + sin(s.x) * cos(s.x * 0.5) + exp(-s.x) + log(s.x + 1.0) + sqrt(s.x) + atan(s.x);
  }
  s.result = s.y;
}
double RESULT(void) { return s.result; }
