/* {{title}}
 *
 * Header only, C99, no heap. Time since the first command, the voltage held over a step:
 *
 *     {{name}}_state motor = {0};
 *     {{name}}_step(&{{name}}_identified, &motor, voltage_v, 0.001);
 *     double current_a = {{name}}_current_a(&{{name}}_identified, &motor);
 *     double speed_rad_s = {{name}}_speed_rad_s(&{{name}}_identified, &motor);
 */
#ifndef {{NAME}}_H
#define {{NAME}}_H

#include <math.h>

typedef struct {
    double {{key}}; /* {{unit}} */
} {{name}}_parameters;

static const {{name}}_parameters {{name}}_identified = {
    .{{key}} = {{value}},
};

/* All zero at rest. */
typedef struct {
    double current_a, speed_rad_s, angle_rad, time_s;
    double {{effect}};
} {{name}}_state;

static inline double {{name}}_sgn(double value) { return (double)((value > 0.0) - (value < 0.0)); }

/* Voltage drop of the effects, V. */
static inline double {{name}}_drop_v(const {{name}}_parameters *p, const {{name}}_state *s, double voltage_v)
{
    (void)p, (void)s, (void)voltage_v;
    return {{voltage}};
}

/* Torque of the effects against positive motion, N.m. */
static inline double {{name}}_torque_n_m(const {{name}}_parameters *p, const {{name}}_state *s, double voltage_v)
{
    (void)p, (void)s, (void)voltage_v;
    return {{torque}};
}

/* Level of the friction, N.m: always against the motion, and it holds the shaft at rest. */
static inline double {{name}}_friction_n_m(const {{name}}_parameters *p, const {{name}}_state *s, double voltage_v)
{
    (void)p, (void)s, (void)voltage_v;
    return fmax(p->load_torque_n_m + {{friction}}, 0.0);
}

/* Rates of change under a voltage; direction is 1 forward, -1 backward, 0 at rest. */
static inline {{name}}_state {{name}}_rates(const {{name}}_parameters *p, const {{name}}_state *s, double voltage_v, int direction)
{
    {{name}}_state rate = {0};
    double inductive_v = voltage_v - {{name}}_drop_v(p, s, voltage_v) - p->resistance_ohm * s->current_a
        - p->back_emf_v_s_per_rad * s->speed_rad_s;
    double net_n_m = p->torque_n_m_per_a * s->current_a - {{name}}_torque_n_m(p, s, voltage_v)
        - direction * {{name}}_friction_n_m(p, s, voltage_v);
    rate.current_a = inductive_v / p->inductance_h * (1.0 + {{current_rate}});
    rate.speed_rad_s = direction ? net_n_m / (p->inertia_kg_m2 * (1.0 + {{inertia}})) : 0.0;
    rate.angle_rad = s->speed_rad_s;
    rate.time_s = 1.0;
    rate.{{effect}} = {{rate}};
    return rate;
}

static inline {{name}}_state {{name}}_moved(const {{name}}_state *s, const {{name}}_state *rate, double h)
{
    {{name}}_state next = *s;
    next.current_a += h * rate->current_a;
    next.speed_rad_s += h * rate->speed_rad_s;
    next.angle_rad += h * rate->angle_rad;
    next.time_s += h * rate->time_s;
    next.{{effect}} += h * rate->{{effect}};
    return next;
}

/* Classical Runge-Kutta over h seconds, the direction as it is. */
static inline {{name}}_state {{name}}_runge_kutta(const {{name}}_parameters *p, const {{name}}_state *s, double voltage_v, int direction, double h)
{
    {{name}}_state there, next;
    {{name}}_state k1 = {{name}}_rates(p, s, voltage_v, direction), k2, k3, k4;
    there = {{name}}_moved(s, &k1, 0.5 * h);
    k2 = {{name}}_rates(p, &there, voltage_v, direction);
    there = {{name}}_moved(s, &k2, 0.5 * h);
    k3 = {{name}}_rates(p, &there, voltage_v, direction);
    there = {{name}}_moved(s, &k3, h);
    k4 = {{name}}_rates(p, &there, voltage_v, direction);
    next = {{name}}_moved(s, &k1, h / 6.0);
    next = {{name}}_moved(&next, &k2, h / 3.0);
    next = {{name}}_moved(&next, &k3, h / 3.0);
    return {{name}}_moved(&next, &k4, h / 6.0);
}

/* Torque that would move the shaft, N.m. */
static inline double {{name}}_driving_n_m(const {{name}}_parameters *p, const {{name}}_state *s, double voltage_v)
{
    return p->torque_n_m_per_a * s->current_a - {{name}}_torque_n_m(p, s, voltage_v);
}

/* How far a state is from the end of its motion, or of its rest; negative beyond. */
static inline double {{name}}_margin(const {{name}}_parameters *p, const {{name}}_state *s, double voltage_v, int direction)
{
    if (direction)
        return direction * s->speed_rad_s;
    return {{name}}_friction_n_m(p, s, voltage_v) - fabs({{name}}_driving_n_m(p, s, voltage_v));
}

/* Direction of the motion; at rest the one in which the motor breaks away, 0 where friction holds it. */
static inline int {{name}}_direction(const {{name}}_parameters *p, const {{name}}_state *s, double voltage_v)
{
    if (s->speed_rad_s != 0.0)
        return s->speed_rad_s > 0.0 ? 1 : -1;
    if ({{name}}_margin(p, s, voltage_v, 0) >= 0.0)
        return 0;
    return {{name}}_driving_n_m(p, s, voltage_v) > 0.0 ? 1 : -1;
}

/* Moves the motor by dt_s seconds under a voltage that is held. */
static inline void {{name}}_step(const {{name}}_parameters *p, {{name}}_state *s, double voltage_v, double dt_s)
{
    const double longest_s = {{longest_s}};
    int steps = (int)ceil(dt_s / longest_s - 1e-6), step, pass, refined;
    for (step = 0; step < steps; ++step) {
        double left_s = dt_s / steps;
        int direction = {{name}}_direction(p, s, voltage_v);
        /* A step is cut where the shaft comes to rest, turns or breaks away. */
        for (pass = 0; pass < 4; ++pass) {
            {{name}}_state next = {{name}}_runge_kutta(p, s, voltage_v, direction, left_s);
            double margin = {{name}}_margin(p, s, voltage_v, direction);
            double after = {{name}}_margin(p, &next, voltage_v, direction), cut_s = left_s;
            if (after >= 0.0) {
                *s = next;
                left_s = 0.0;
                break;
            }
            for (refined = 0; refined < 4 && cut_s > 0.0; ++refined) {
                cut_s *= margin / (margin - after);
                next = {{name}}_runge_kutta(p, s, voltage_v, direction, cut_s);
                after = {{name}}_margin(p, &next, voltage_v, direction);
            }
            *s = next;
            s->speed_rad_s = 0.0;
            left_s -= cut_s;
            if (direction)
                direction = {{name}}_direction(p, s, voltage_v);
            else
                direction = {{name}}_driving_n_m(p, s, voltage_v) > 0.0 ? 1 : -1;
        }
        if (left_s > 0.0) {
            *s = {{name}}_runge_kutta(p, s, voltage_v, 0, left_s);
            s->speed_rad_s = 0.0;
        }
    }
}

/* As the sensors show it. */
static inline double {{name}}_current_a(const {{name}}_parameters *p, const {{name}}_state *s)
{
    (void)p;
    return s->current_a + {{current_reading}};
}

static inline double {{name}}_speed_rad_s(const {{name}}_parameters *p, const {{name}}_state *s)
{
    (void)p;
    return s->speed_rad_s + {{speed_reading}};
}
{{regulator}}
#endif
