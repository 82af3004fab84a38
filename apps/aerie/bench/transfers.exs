# Measures how fast all parameters of a simulated vehicle are read over UDP that loses frames in both directions: by the list
# (PARAM_REQUEST_LIST) and by ArduPilot's parameter file (MAVLink FTP), by Aerie's machines and by pymavlink, straight to the
# same vehicle.
#
#     bin/bench transfers [--rounds 5] [--params 1400]
#
# Columns: parameters per second, the median of the rounds, at each loss (share of frames in each direction). The vehicle sends
# at most 2,000 parameters a second of a list, as ArduPilot's simulator does, and 1,000 packets a second of a file. Aerie is told a
# round trip of 5 ms, as a link measures it; its file is read with checksums before and after it.

Code.require_file("../../mav_codec/bench/support/options.ex", __DIR__)
Code.require_file("../../vehicle/test/support/udp_transfer.ex", __DIR__)

alias Aerie.Control.Params.{Download, Fetch, Table}
alias Aerie.UdpTransfer

options = MavCodec.Bench.Options.read(__ENV__.file, System.argv(), rounds: 5, params: 1400)
Logger.configure(level: :error)

losses = [0.0, 0.05, 0.25]
python = Path.join(System.get_env("AERIE_VENV") || Path.expand("../../../.venv", __DIR__), "bin/python")
script = Path.expand("support/params_pymavlink.py", __DIR__)
minutes = 120_000_000

vehicle = fn port, loss, seed ->
  {:ok, sim} =
    SimVehicle.start_link(
      firmware: :ardupilot,
      link: "udpout:127.0.0.1:#{port}",
      seed: seed,
      # Its steps are as short as its fastest stream needs.
      rates: %{30 => 100},
      more_params:
        for(n <- 1..(options[:params] - 182), do: {"MORE_#{n}", n, Enum.at([2, 4, 6, 9], rem(n, 4))})
    )

  for direction <- [:in, :out], do: :ok = SimVehicle.fault(sim, :loss, loss, direction)
  sim
end

aerie = fn module, more ->
  fn loss, seed ->
    {socket, port} = UdpTransfer.open()
    sim = vehicle.(port, loss, seed)
    machine = module.new({1, 1}, UdpTransfer.now() + minutes, more)

    {us, {{:ok, table}, _bytes}} =
      :timer.tc(fn -> UdpTransfer.run({socket, SimVehicle.port(sim)}, module, machine) end)

    GenServer.stop(sim)
    :gen_udp.close(socket)
    Table.count(table) / us * 1.0e6
  end
end

pymavlink = fn way ->
  fn loss, seed ->
    {socket, port} = UdpTransfer.open()
    :gen_udp.close(socket)
    peer = Task.async(fn -> System.cmd(python, [script, "#{port}", way], stderr_to_stdout: true) end)
    sim = vehicle.(port, loss, seed)
    {output, code} = Task.await(peer, :infinity)
    GenServer.stop(sim)

    with 0 <- code,
         [count, seconds] <- output |> String.split("\n", trim: true) |> List.last() |> String.split(),
         {count, ""} when count > 0 <- Integer.parse(count) do
      count / String.to_float(seconds)
    else
      _failed -> nil
    end
  end
end

ways =
  [
    {"Aerie, list", aerie.(Download, rtt_us: 5_000)},
    {"Aerie, parameter file", aerie.(Fetch, file: true, rtt_us: 5_000)}
  ] ++
    if File.exists?(python),
      do: [{"pymavlink, list", pymavlink.("list")}, {"pymavlink, parameter file", pymavlink.("file")}],
      else: []

median = fn
  [] -> "failed"
  rates -> rates |> Enum.sort() |> Enum.at(div(length(rates), 2)) |> round() |> Integer.to_string()
end

IO.puts("#{options[:params]} parameters, parameters per second, median of #{options[:rounds]}\n")

IO.puts(
  String.pad_trailing("", 28) <> Enum.map_join(losses, &String.pad_leading("#{round(&1 * 100)} % loss", 12))
)

for {name, run} <- ways do
  cells =
    for loss <- losses do
      rates = for seed <- 1..options[:rounds], rate = run.(loss, seed), do: rate
      failed = options[:rounds] - length(rates)
      median.(rates) <> if(failed > 0 and rates != [], do: " (#{failed} failed)", else: "")
    end

  IO.puts(String.pad_trailing(name, 28) <> Enum.map_join(cells, &String.pad_leading(&1, 12)))
end
