
/* PI speed regulator, every period_s seconds:
 *
 *     {{name}}_regulator speed_loop = {0};
 *     double voltage_v = {{name}}_regulate(&{{name}}_tuned, &speed_loop, reference_rad_s, speed_rad_s);
 */
typedef struct {
    double proportional_v_s_per_rad, integral_time_s, reference_filter_s, period_s, limit_v;
    /* What holds a speed: back-EMF and viscous friction, Coulomb friction. */
    double holding_v_s_per_rad, holding_v;
    /* By how much what is seen is older than what leaves the limit. */
    double leaving_s;
} {{name}}_gains;

static const {{name}}_gains {{name}}_tuned = { {{gains}} };

typedef struct {
    double integral_v, load_v, reference_rad_s, speed_rad_s;
    int limited, running;
} {{name}}_regulator;

static inline double {{name}}_holding_v(const {{name}}_gains *g, double speed_rad_s)
{
    return g->holding_v_s_per_rad * speed_rad_s + g->holding_v * fmax(-1.0, fmin(1.0, 0.5 * speed_rad_s));
}

static inline double {{name}}_regulate(const {{name}}_gains *g, {{name}}_regulator *r, double reference_rad_s, double speed_rad_s)
{
    double share = g->reference_filter_s > 0.0 ? 1.0 - exp(-g->period_s / g->reference_filter_s) : 1.0;
    double before_rad_s = r->running ? r->reference_rad_s : speed_rad_s;
    double error_rad_s, growth_v, wanted_v, voltage_v;
    r->running = 1;
    r->reference_rad_s = before_rad_s + share * (reference_rad_s - before_rad_s);
    error_rad_s = r->reference_rad_s - speed_rad_s;
    growth_v = g->proportional_v_s_per_rad * g->period_s / g->integral_time_s * error_rad_s;
    if (growth_v * r->limited > 0.0) {
        /* While the output is limited the integral follows what holds the speed that is there when an output acts. */
        double lead = g->leaving_s * (speed_rad_s - r->speed_rad_s) / g->period_s / error_rad_s;
        r->integral_v = {{name}}_holding_v(g, speed_rad_s + fmax(0.0, fmin(0.4, lead)) * error_rad_s) + r->load_v;
    } else {
        if (!r->limited)
            r->load_v = r->integral_v - {{name}}_holding_v(g, speed_rad_s);
        r->integral_v += growth_v;
    }
    r->speed_rad_s = speed_rad_s;
    wanted_v = g->proportional_v_s_per_rad * error_rad_s + r->integral_v;
    voltage_v = fmax(-g->limit_v, fmin(g->limit_v, wanted_v));
    r->limited = (wanted_v > voltage_v) - (wanted_v < voltage_v);
    return voltage_v;
}
