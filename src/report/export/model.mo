model {{Name}} "{{title}}"
  input Real voltage_v(unit = "V");
  output Real current_a(unit = "A") = i + {{current_reading}} "as the sensor shows it";
  output Real speed_rad_s(unit = "rad/s") = w + {{speed_reading}} "as the sensor shows it";
  parameter Real {{key}}(unit = "{{unit}}") = {{value}};
  Real i(unit = "A", start = 0.0, fixed = true);
  Real w(unit = "rad/s", start = 0.0, fixed = true);
  Real angle_rad(unit = "rad", start = 0.0, fixed = true);
  Real {{state}}(start = 0.0, fixed = true);
  Real drop_v(unit = "V") "of the effects";
  Real torque_n_m(unit = "N.m") "of the effects, against positive motion";
  Real friction_n_m(unit = "N.m") "always against the motion; it holds the shaft at rest";
  Real driving_n_m(unit = "N.m");
  Boolean comes_to_rest, breaks_away;
  Integer direction(start = 0) "1 forward, -1 backward, 0 at rest";
equation
  drop_v = {{voltage}};
  torque_n_m = {{torque}};
  friction_n_m = max(load_torque_n_m + {{friction}}, 0.0);
  driving_n_m = torque_n_m_per_a * i - torque_n_m;
  inductance_h * der(i) = (voltage_v - drop_v - resistance_ohm * i - back_emf_v_s_per_rad * w) * (1.0 + {{current_rate}});
  der(w) = if direction == 0 then 0.0 else (driving_n_m - direction * friction_n_m) / (inertia_kg_m2 * (1.0 + {{inertia}}));
  der(angle_rad) = w;
  der({{state}}) = {{rate}};
  comes_to_rest = pre(direction) * w < 0.0;
  breaks_away = pre(direction) == 0 and abs(driving_n_m) > friction_n_m;
  when {initial(), comes_to_rest, breaks_away} then
    direction = if driving_n_m > friction_n_m then 1 elseif driving_n_m < -friction_n_m then -1 else 0;
  end when;
  when comes_to_rest then
    reinit(w, 0.0);
  end when;
end {{Name}};
