

class {{Name}}Regulator:
    """PI speed regulator: voltage_v = regulator.step(reference_rad_s, speed_rad_s) every period_s seconds."""

    def __init__(self):
        (
            self.proportional_v_s_per_rad,
            self.integral_time_s,
            self.reference_filter_s,
            self.period_s,
            self.limit_v,
            self.holding_v_s_per_rad,
            self.holding_v,
            self.leaving_s,
        ) = ({{gains}})
        self.integral_v = self.load_v = self.speed_rad_s = 0.0
        self.reference_rad_s = None
        self.limited = 0.0

    def held_v(self, speed_rad_s):
        """What holds a speed: back-EMF and viscous friction, Coulomb friction."""
        sign = max(-1.0, min(1.0, 0.5 * speed_rad_s))
        return self.holding_v_s_per_rad * speed_rad_s + self.holding_v * sign

    def step(self, reference_rad_s, speed_rad_s):
        filter_s = self.reference_filter_s
        share = 1.0 - math.exp(-self.period_s / filter_s) if filter_s > 0.0 else 1.0
        before_rad_s = speed_rad_s if self.reference_rad_s is None else self.reference_rad_s
        self.reference_rad_s = before_rad_s + share * (reference_rad_s - before_rad_s)
        error_rad_s = self.reference_rad_s - speed_rad_s
        growth_v = self.proportional_v_s_per_rad * self.period_s / self.integral_time_s * error_rad_s
        if growth_v * self.limited > 0.0:
            # While the output is limited the integral follows what holds the speed that is there when an output acts.
            lead = self.leaving_s * (speed_rad_s - self.speed_rad_s) / self.period_s / error_rad_s
            leaving_rad_s = speed_rad_s + max(0.0, min(0.4, lead)) * error_rad_s
            self.integral_v = self.held_v(leaving_rad_s) + self.load_v
        else:
            if not self.limited:
                self.load_v = self.integral_v - self.held_v(speed_rad_s)
            self.integral_v += growth_v
        self.speed_rad_s = speed_rad_s
        wanted_v = self.proportional_v_s_per_rad * error_rad_s + self.integral_v
        voltage_v = max(-self.limit_v, min(self.limit_v, wanted_v))
        self.limited = sgn(wanted_v - voltage_v)
        return voltage_v
