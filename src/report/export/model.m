function m = {{name}}()
% {{title}}
%
% MATLAB and GNU Octave. Time since the first command, the voltage held over a step:
%
%   m = {{name}}();
%   s = m.start();                                % at rest: current, speed, angle, time{{state_names}}
%   s = m.step(m.parameters, s, voltage_v, 0.001);
%   [current_a, speed_rad_s] = m.read(m.parameters, s);
%   [current_a, speed_rad_s] = m.simulate(m.parameters, time_s, voltage_v);
  p.{{key}} = {{value}}; % {{unit}}
  m.parameters = p;
  m.start = @() zeros({{state_count}}, 1);
  m.step = @step;
  m.read = @read;
  m.simulate = @simulate;
  m.gains.{{gain_key}} = {{gain}};
  m.regulate = @{{regulate}};
end

% Voltage drop of the effects, V.
function v = drop_v(p, s, voltage_v)
  v = {{voltage}};
end

% Torque of the effects against positive motion, N.m.
function v = torque_n_m(p, s, voltage_v)
  v = {{torque}};
end

% Level of the friction, N.m: always against the motion, and it holds the shaft at rest.
function v = friction_n_m(p, s, voltage_v)
  v = max(p.load_torque_n_m + {{friction}}, 0.0);
end

% Rates of change; direction is 1 forward, -1 backward, 0 at rest.
function rate = rates(p, s, voltage_v, direction)
  inductive_v = voltage_v - drop_v(p, s, voltage_v) - p.resistance_ohm * s(1) - p.back_emf_v_s_per_rad * s(2);
  net_n_m = driving_n_m(p, s, voltage_v) - direction * friction_n_m(p, s, voltage_v);
  rate = zeros({{state_count}}, 1);
  rate(1) = inductive_v / p.inductance_h * (1.0 + {{current_rate}});
  if direction ~= 0
    rate(2) = net_n_m / (p.inertia_kg_m2 * (1.0 + {{inertia}}));
  end
  rate(3) = s(2);
  rate(4) = 1.0;
  rate({{index}}) = {{rate}};
end

% The state after h seconds, the direction as it is.
function next = runge_kutta(p, s, voltage_v, direction, h)
  k1 = rates(p, s, voltage_v, direction);
  k2 = rates(p, s + 0.5 * h * k1, voltage_v, direction);
  k3 = rates(p, s + 0.5 * h * k2, voltage_v, direction);
  k4 = rates(p, s + h * k3, voltage_v, direction);
  next = s + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4);
end

% Torque that would move the shaft, N.m.
function v = driving_n_m(p, s, voltage_v)
  v = p.torque_n_m_per_a * s(1) - torque_n_m(p, s, voltage_v);
end

% How far a state is from the end of its motion, or of its rest; negative beyond.
function margin = margin_of(p, s, voltage_v, direction)
  if direction ~= 0
    margin = direction * s(2);
  else
    margin = friction_n_m(p, s, voltage_v) - abs(driving_n_m(p, s, voltage_v));
  end
end

% Direction of the motion; at rest the one in which the motor breaks away, 0 where friction holds it.
function direction = direction_of(p, s, voltage_v)
  if s(2) ~= 0.0
    direction = sign(s(2));
  elseif margin_of(p, s, voltage_v, 0) >= 0.0
    direction = 0;
  else
    direction = sign(driving_n_m(p, s, voltage_v));
  end
end

% Moves the motor by dt_s seconds under a voltage that is held.
function s = step(p, s, voltage_v, dt_s)
  steps = ceil(dt_s / {{longest_s}} - 1e-6);
  for n = 1:steps
    left_s = dt_s / steps;
    direction = direction_of(p, s, voltage_v);
    % A step is cut where the shaft comes to rest, turns or breaks away.
    for pass = 1:4
      there = runge_kutta(p, s, voltage_v, direction, left_s);
      margin = margin_of(p, s, voltage_v, direction);
      after = margin_of(p, there, voltage_v, direction);
      if after >= 0.0
        s = there;
        left_s = 0.0;
        break
      end
      cut_s = left_s;
      refined = 0;
      while refined < 4 && cut_s > 0.0
        cut_s = cut_s * margin / (margin - after);
        there = runge_kutta(p, s, voltage_v, direction, cut_s);
        after = margin_of(p, there, voltage_v, direction);
        refined = refined + 1;
      end
      s = there;
      s(2) = 0.0;
      left_s = left_s - cut_s;
      if direction ~= 0
        direction = direction_of(p, s, voltage_v);
      else
        direction = sign(driving_n_m(p, s, voltage_v));
      end
    end
    if left_s > 0.0
      s = runge_kutta(p, s, voltage_v, 0, left_s);
      s(2) = 0.0;
    end
  end
end

% As the sensors show it.
function [current_a, speed_rad_s] = read(p, s)
  current_a = s(1) + {{current_reading}};
  speed_rad_s = s(2) + {{speed_reading}};
end

% Current and speed at the times, each voltage held until the next.
function [current_a, speed_rad_s] = simulate(p, time_s, voltage_v)
  s = zeros({{state_count}}, 1);
  current_a = zeros(numel(time_s), 1);
  speed_rad_s = zeros(numel(time_s), 1);
  for row = 1:numel(time_s)
    if row > 1
      s = step(p, s, voltage_v(row - 1), time_s(row) - time_s(row - 1));
    end
    [current_a(row), speed_rad_s(row)] = read(p, s);
  end
end
{{regulator}}
