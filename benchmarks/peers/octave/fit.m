1;  % GNU Octave with its control package: moen4 and n4sid of the known order.
%
% Called as   octave-cli fit.m WAY POLES ZEROS FILE...   ; answers as protocol.py does, a JSON line
% a record. "moen4", "n4sid": the order is given, the rest is left at the defaults, which make 2 n
% block rows. "..., tuned": 40 samples of rest are put before the record, and of 2 n, 10, 20, 40 and 80
% block rows those are kept whose simulation from the estimated initial state is nearest to the
% record. The records have no offset, so nothing is detrended. The conversion is that of protocol.py:
% the matrix logarithm of [A B; 0 I].

function say (facts)
  printf ("%s\n", jsonencode (facts));
  fflush (stdout);
endfunction

function size = peak ()
  size = 0;
  if (exist ("/proc/self/status", "file"))
    found = regexp (fileread ("/proc/self/status"), 'VmHWM:\s*(\d+) kB', "tokens", "once");
    size = str2double (found{1}) * 1024 / 1e6;
  endif
endfunction

function theta = continuous (sys, dt, n, m)
  [a, b, c, d] = ssdata (sys);
  if (rows (a) != n)
    error ("WrongOrder:states", "%d states", rows (a));
  endif
  e = eig (a);
  on_axis = abs (imag (e)) <= 1e-12 * abs (e);
  if (any (on_axis & real (e) <= 0))
    error ("NoContinuousModel:pole", "discrete-time pole on the negative real axis");
  endif
  rates = logm ([a, b; zeros(1, n), 1]);
  if (max (abs (imag (rates(:)))) > 1e-6 * max (abs (rates(:))))
    error ("NoContinuousModel:complex", "complex logarithm");
  endif
  rates = real (rates) / dt;
  f = rates(1:n,1:n);
  g = rates(1:n,n+1);
  den = real (poly (f));
  num = real (poly (f - g * c)) + (d - 1) * den;
  theta = [den(2:end), num(end-m:end)];
endfunction

function theta = fit (way, u, y, dt, n, m)
  words = strsplit (way, ", ");
  if (numel (words) == 1)
    theta = continuous (feval (words{1}, iddata (y, u, dt), n), dt, n, m);
    return;
  endif
  u = [zeros(40, 1); u];
  y = [zeros(40, 1); y];
  data = iddata (y, u, dt);
  most = fix ((rows (y) + 1) / 6);  % what the functions accept with one input and one output
  best = Inf;
  theta = [];
  for s = min ([2 * n, 10, 20, 40, 80], most)
    try
      [sys, x0] = feval (words{1}, data, n, "s", s);
      candidate = continuous (sys, dt, n, m);
      simulated = lsim (sys, u, [], x0);
      cost = mean ((simulated - y) .^ 2);
      if (cost < best)
        best = cost;
        theta = candidate;
      endif
    catch problem
    end_try_catch
  endfor
  if (isempty (theta))
    error (problem);
  endif
endfunction

pkg load control
warning ("off", "all");
arguments = argv ();
way = arguments{1};
n = str2double (arguments{2});
m = str2double (arguments{3});
installed = pkg ("list", "control");
say (struct ("versions", struct ("octave", version (), "control", installed{1}.version)));
for k = 4:numel (arguments)
  table = dlmread (arguments{k}, ",", 1, 0);
  dt = (table(end,1) - table(1,1)) / (rows (table) - 1);
  [folder, stem, ending] = fileparts (arguments{k});
  answer = struct ("file", [stem, ending]);
  before = cputime ();
  try
    answer.theta = fit (way, table(:,2), table(:,3), dt, n, m);
    if (! all (isfinite (answer.theta)))
      error ("NoContinuousModel:finite", "coefficients not finite");
    endif
  catch problem
    answer = struct ("file", [stem, ending]);
    kind = strsplit (problem.identifier, ":"){1};
    if (isempty (kind))
      kind = "error";
    endif
    answer.error = kind;
    answer.message = problem.message;
  end_try_catch
  answer.seconds = cputime () - before;
  answer.at = cputime ();
  answer.peak = peak ();
  say (answer);
endfor
