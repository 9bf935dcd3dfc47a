"""{{title}}

Time since the first command, the voltage held over a step:

    motor = {{Name}}()
    motor.step(voltage_v, 0.001)
    motor.current_a(), motor.speed_rad_s()

    current_a, speed_rad_s = {{Name}}().simulate(time_s, voltage_v)
"""

import math

import numpy as np


def sgn(value):
    return math.copysign(1.0, value) if value else 0.0


class {{Name}}:
    """The model; parameters may be changed: {{Name}}(inertia_kg_m2=0.005)."""

    LONGEST_STEP_S = {{longest_s}}

    def __init__(self, **changed):
        self.{{key}} = {{value}}  # {{unit}}
        for key, value in changed.items():
            if key not in self.__dict__:
                raise TypeError(f"{key} is not a parameter: {', '.join(self.__dict__)}")
            setattr(self, key, value)
        # Current, speed, angle, time{{state_names}}.
        self.state = np.zeros({{state_count}})

    def drop_v(self, s, voltage_v):
        """Voltage drop of the effects, V."""
        return {{voltage}}

    def torque_n_m(self, s, voltage_v):
        """Torque of the effects against positive motion, N.m."""
        return {{torque}}

    def friction_n_m(self, s, voltage_v):
        """Level of the friction, N.m: always against the motion, and it holds the shaft at rest."""
        return max(self.load_torque_n_m + {{friction}}, 0.0)

    def rates(self, s, voltage_v, direction):
        """Rates of change; direction is 1 forward, -1 backward, 0 at rest."""
        inductive_v = (
            voltage_v
            - self.drop_v(s, voltage_v)
            - self.resistance_ohm * s[0]
            - self.back_emf_v_s_per_rad * s[1]
        )
        net_n_m = self.driving_n_m(s, voltage_v) - direction * self.friction_n_m(s, voltage_v)
        return np.array([
            inductive_v / self.inductance_h * (1.0 + {{current_rate}}),
            net_n_m / (self.inertia_kg_m2 * (1.0 + {{inertia}})) if direction else 0.0,
            s[1],
            1.0,
            {{rate}},
        ])

    def runge_kutta(self, s, voltage_v, direction, h):
        """The state after h seconds, the direction as it is."""
        k1 = self.rates(s, voltage_v, direction)
        k2 = self.rates(s + 0.5 * h * k1, voltage_v, direction)
        k3 = self.rates(s + 0.5 * h * k2, voltage_v, direction)
        k4 = self.rates(s + h * k3, voltage_v, direction)
        return s + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)

    def driving_n_m(self, s, voltage_v):
        """Torque that would move the shaft."""
        return self.torque_n_m_per_a * s[0] - self.torque_n_m(s, voltage_v)

    def margin(self, s, voltage_v, direction):
        """How far a state is from the end of its motion, or of its rest; negative beyond."""
        if direction:
            return direction * s[1]
        return self.friction_n_m(s, voltage_v) - abs(self.driving_n_m(s, voltage_v))

    def direction(self, s, voltage_v):
        """Direction of the motion; at rest the one in which the motor breaks away, 0 where friction holds it."""
        if s[1] != 0.0:
            return 1 if s[1] > 0.0 else -1
        if self.margin(s, voltage_v, 0) >= 0.0:
            return 0
        return 1 if self.driving_n_m(s, voltage_v) > 0.0 else -1

    def step(self, voltage_v, dt_s):
        """Moves the motor by dt_s seconds under a voltage that is held."""
        s = self.state
        steps = math.ceil(dt_s / self.LONGEST_STEP_S - 1e-6)
        for _ in range(steps):
            left_s = dt_s / steps
            direction = self.direction(s, voltage_v)
            # A step is cut where the shaft comes to rest, turns or breaks away.
            for _ in range(4):
                there = self.runge_kutta(s, voltage_v, direction, left_s)
                margin = self.margin(s, voltage_v, direction)
                after = self.margin(there, voltage_v, direction)
                if after >= 0.0:
                    s, left_s = there, 0.0
                    break
                cut_s, refined = left_s, 0
                while refined < 4 and cut_s > 0.0:
                    cut_s *= margin / (margin - after)
                    there = self.runge_kutta(s, voltage_v, direction, cut_s)
                    after = self.margin(there, voltage_v, direction)
                    refined += 1
                s = there
                s[1] = 0.0
                left_s -= cut_s
                if direction:
                    direction = self.direction(s, voltage_v)
                else:
                    direction = 1 if self.driving_n_m(s, voltage_v) > 0.0 else -1
            if left_s > 0.0:
                s = self.runge_kutta(s, voltage_v, 0, left_s)
                s[1] = 0.0
        self.state = s

    def current_a(self):
        """As the sensor shows it."""
        s = self.state
        return s[0] + {{current_reading}}

    def speed_rad_s(self):
        """As the sensor shows it."""
        s = self.state
        return s[1] + {{speed_reading}}

    def simulate(self, time_s, voltage_v):
        """Current and speed at the times, each voltage held until the next."""
        current_a, speed_rad_s = np.empty(len(time_s)), np.empty(len(time_s))
        for row in range(len(time_s)):
            if row:
                self.step(float(voltage_v[row - 1]), float(time_s[row] - time_s[row - 1]))
            current_a[row], speed_rad_s[row] = self.current_a(), self.speed_rad_s()
        return current_a, speed_rad_s
{{regulator}}
