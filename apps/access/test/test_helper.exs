Aerie.Patience.load_code()
ExUnit.start(max_cases: System.schedulers_online(), exclude: [:long, :soak])
