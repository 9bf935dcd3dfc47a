/* {{title}}
 *
 * Torque against positive motion, N.m, over {{axis}}: means of {{count}} bins, {{width}} {{unit}} wide, from {{first}} {{unit}} on;
 * NAN where nothing was measured. low and high hold the mean with 95 % confidence, Kt and J of the model taken as right.
 *
 *     float torque_n_m;
 *     if ({{name}}_torque({{place}}, &torque_n_m))
 *         voltage_v += resistance_ohm / torque_n_m_per_a * torque_n_m;
 */
#ifndef {{NAME}}_H
#define {{NAME}}_H

#include <math.h>

enum { {{NAME}}_BINS = {{count}} };

static const float {{name}}_first_{{suffix}} = {{first}}f, {{name}}_width_{{suffix}} = {{width}}f;

static const float {{name}}_torque_n_m[{{NAME}}_BINS] = {
{{means}}
};

static const float {{name}}_low_n_m[{{NAME}}_BINS] = {
{{lows}}
};

static const float {{name}}_high_n_m[{{NAME}}_BINS] = {
{{highs}}
};

/* The torque, on the line between the middles of two bins; 0 where nothing is known, and torque_n_m is left as it is. */
static inline int {{name}}_torque(float {{place}}, float *torque_n_m)
{
    float along, off, here, there;
    int own, next;
{{wrap}}
    along = ({{place}} - {{name}}_first_{{suffix}}) / {{name}}_width_{{suffix}};
    if (!({{inside}}))
        return 0;
    own = (int)along;
    if (own >= {{NAME}}_BINS)
        own = {{NAME}}_BINS - 1;
    here = {{name}}_torque_n_m[own];
    if (isnan(here))
        return 0;
    off = along - (float)own - 0.5f;
    next = own + (off < 0.0f ? -1 : 1);
{{beyond}}
    *torque_n_m = isnan(there) ? here : here + fabsf(off) * (there - here);
    return 1;
}

#endif
