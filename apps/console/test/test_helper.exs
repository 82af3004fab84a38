Aerie.Patience.load_code()
Application.put_env(:vehicle, :gateway_parts, [Aerie.ControlParts, Aerie.FleetParts])

# Long suites run with `bin/test --full`, hour-long ones with `bin/test --soak`.
# A browser that draws maps without a graphics card keeps a core busy.
ExUnit.start(max_cases: System.schedulers_online(), exclude: [:long, :soak] ++ Aerie.Browser.excluded())
