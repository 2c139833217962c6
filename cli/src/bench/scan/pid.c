typedef struct { double sp, pv, kp, ki, kd, dt, out, integral, last, err, der; } Pid;
static struct { Pid c[32]; double y[32]; int16_t i; int32_t n; double sum, result; int ready; } s;
static double limit(double lo, double v, double hi) { double m = v > lo ? v : lo; return m < hi ? m : hi; }
static void pid(Pid *f) {
  f->err = f->sp - f->pv;
  f->integral = limit(-50.0, f->integral + f->err * f->dt, 50.0);
  f->der = (f->err - f->last) / f->dt;
  f->last = f->err;
  f->out = limit(-100.0, f->kp * f->err + f->ki * f->integral + f->kd * f->der, 100.0);
}
void SCAN(int64_t now) {
  if (!s.ready) { s.ready = 1; for (int i = 0; i < 32; i++) { s.c[i].kp = 1.2; s.c[i].ki = 0.4; s.c[i].kd = 0.05; s.c[i].dt = 0.01; } }
  s.n++; s.sum = 0;
  for (s.i = 0; s.i <= 31; s.i++) {
    Pid *c = &s.c[s.i];
    c->sp = s.i + (s.n % 100) * 0.1; c->pv = s.y[s.i]; pid(c);
    s.y[s.i] = s.y[s.i] + (c->out - s.y[s.i]) * 0.02;
    s.sum = s.sum + s.y[s.i];
  }
  s.result = s.sum;
}
double RESULT(void) { return s.result; }
