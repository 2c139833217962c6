typedef struct { double position, velocity, target; uint8_t moving; int32_t count; } Axis;
static struct { Axis axes[64]; int16_t i; int32_t total; double result; } s;
void SCAN(int64_t now) {
  s.total = 0;
  for (s.i = 0; s.i <= 63; s.i++) {
    Axis *a = &s.axes[s.i];
    if (!a->moving) { a->target = s.i * 10.0 - a->target; a->moving = 1; a->count++; }
    a->velocity = (a->target - a->position) * 0.1;
    a->position = a->position + a->velocity;
    if (fabs(a->target - a->position) < 0.5) a->moving = 0;
    s.total += a->count;
  }
  s.result = s.total + s.axes[7].position;
}
double RESULT(void) { return s.result; }
