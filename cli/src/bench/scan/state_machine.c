enum { Idle, Starting, Running, Slow, Fast, Stopping, Fault, Reset };
static struct { int16_t mode; int32_t ticks; int16_t speed, k; int32_t faults, hours; int64_t result; } s;
void SCAN(int64_t now) {
  for (s.k = 1; s.k <= 100; s.k++) {
    s.ticks++;
    switch (s.mode) {
      case Idle: if (s.ticks % 7 == 0) { s.mode = Starting; s.speed = 0; } break;
      case Starting: s.speed += 5; if (s.speed >= 50) s.mode = Running; break;
      case Running: if (s.ticks % 3 == 0) s.mode = Slow; else s.mode = Fast; break;
      case Slow: s.speed -= 3; if (s.speed < 20) s.mode = Stopping; else s.mode = Running; break;
      case Fast: s.speed += 1; if (s.speed > 90) s.mode = Fault; else s.mode = Running; break;
      case Stopping: s.speed -= 1; if (s.speed <= 0) { s.mode = Idle; s.hours++; } break;
      case Fault: s.faults++; s.mode = Reset; break;
      case Reset: s.speed = 30; s.mode = Running; break;
    }
  }
  s.result = s.ticks + s.speed + s.faults * 10 + s.hours * 100;
}
double RESULT(void) { return (double)s.result; }
