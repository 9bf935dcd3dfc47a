
/* PI speed regulator, every period_s seconds:
 *
 *     {{name}}_regulator speed_loop = {0};
 *     double voltage_v = {{name}}_regulate(&{{name}}_tuned, &speed_loop, reference_rad_s, speed_rad_s);
 */
typedef struct {
    double proportional_v_s_per_rad, integral_time_s, reference_filter_s, period_s, limit_v;
    /* What holds a speed: back-EMF and viscous friction, Coulomb friction. */
    double holding_v_s_per_rad, holding_v;
} {{name}}_gains;

static const {{name}}_gains {{name}}_tuned = { {{gains}} };

typedef struct {
    double integral_v, load_v, reference_rad_s;
    int limited, running;
} {{name}}_regulator;

static inline double {{name}}_regulate(const {{name}}_gains *g, {{name}}_regulator *r, double reference_rad_s, double speed_rad_s)
{
    double share = g->reference_filter_s > 0.0 ? 1.0 - exp(-g->period_s / g->reference_filter_s) : 1.0;
    double before_rad_s = r->running ? r->reference_rad_s : speed_rad_s;
    double holding_v = g->holding_v_s_per_rad * speed_rad_s + g->holding_v * fmax(-1.0, fmin(1.0, 0.5 * speed_rad_s));
    double error_rad_s, growth_v, wanted_v, voltage_v;
    r->running = 1;
    r->reference_rad_s = before_rad_s + share * (reference_rad_s - before_rad_s);
    error_rad_s = r->reference_rad_s - speed_rad_s;
    growth_v = g->proportional_v_s_per_rad * g->period_s / g->integral_time_s * error_rad_s;
    if (growth_v * r->limited > 0.0) {
        /* While the output is limited the integral follows what holds the present speed. */
        r->integral_v = holding_v + r->load_v;
    } else {
        r->integral_v += growth_v;
        if (!r->limited)
            r->load_v = r->integral_v - holding_v;
    }
    wanted_v = g->proportional_v_s_per_rad * error_rad_s + r->integral_v;
    voltage_v = fmax(-g->limit_v, fmin(g->limit_v, wanted_v));
    r->limited = (wanted_v > voltage_v) - (wanted_v < voltage_v);
    return voltage_v;
}
