Aerie.Patience.load_code()
Application.put_env(:vehicle, :gateway_parts, [Aerie.ControlParts, Aerie.FleetParts])

# Long suites run with `bin/test --full`, hour-long ones with `bin/test --soak`.
ExUnit.start(max_cases: System.schedulers_online(), exclude: [:long, :soak])
