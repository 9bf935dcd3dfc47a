
% PI speed regulator, every g.period_s seconds: [voltage_v, r] = m.regulate(m.gains, r, reference_rad_s, speed_rad_s),
% which begins with an empty r.
function [voltage_v, r] = regulate(g, r, reference_rad_s, speed_rad_s)
  if isempty(r)
    r = struct('integral_v', 0.0, 'load_v', 0.0, 'reference_rad_s', speed_rad_s, 'speed_rad_s', speed_rad_s, 'limited', 0.0);
  end
  share = 1.0;
  if g.reference_filter_s > 0.0
    share = 1.0 - exp(-g.period_s / g.reference_filter_s);
  end
  r.reference_rad_s = r.reference_rad_s + share * (reference_rad_s - r.reference_rad_s);
  error_rad_s = r.reference_rad_s - speed_rad_s;
  % What holds a speed: back-EMF and viscous friction, Coulomb friction.
  held_v = @(speed) g.holding_v_s_per_rad * speed + g.holding_v * max(-1.0, min(1.0, 0.5 * speed));
  growth_v = g.proportional_v_s_per_rad * g.period_s / g.integral_time_s * error_rad_s;
  if growth_v * r.limited > 0.0
    % While the output is limited the integral follows what holds the speed that is there when an output acts.
    lead = g.leaving_s * (speed_rad_s - r.speed_rad_s) / g.period_s / error_rad_s;
    r.integral_v = held_v(speed_rad_s + max(0.0, min(0.4, lead)) * error_rad_s) + r.load_v;
  else
    if r.limited == 0.0
      r.load_v = r.integral_v - held_v(speed_rad_s);
    end
    r.integral_v = r.integral_v + growth_v;
  end
  r.speed_rad_s = speed_rad_s;
  wanted_v = g.proportional_v_s_per_rad * error_rad_s + r.integral_v;
  voltage_v = max(-g.limit_v, min(g.limit_v, wanted_v));
  r.limited = sign(wanted_v - voltage_v);
end
