# What the console's fleet page costs: viewers that each have it open by a WebSocket of their own (compressed, as browsers do), and
# vehicles whose numbers change five times a second, spread over time; twice a second the mode of one of them changes, too. The gateway's VM has
# one scheduler if it is started so (ELIXIR_ERL_OPTIONS="+S 1:1"); the viewers are another OS process.
#
#     bin/bench console [--vehicles 10,50,200] [--viewers 0,1,5,20] [--seconds 10] [--browser] [--out FILE]
#
# Prints a table in Markdown: how often each vehicle changed in a second, CPU of the gateway's OS process in per cent of one core (all, and what each viewer adds to none), bytes a second
# that a viewer gets, and the time from a change in the store to the frame that has it at the viewer (ms): of a mode, which shows at once, and
# of numbers, which the table of more than 50 vehicles shows less often. With --browser one more viewer is a page in Chromium (without WebGL),
# and the last column is the time until its DOM has the change of a mode. FILE gets the rows as JSON, for bench/support/plot_console.py.

Code.require_file("../../mav_codec/bench/support/options.ex", __DIR__)
Code.require_file("../../../test/browser/browser.ex", __DIR__)

defmodule ConsoleBench do
  @moduledoc false
  alias Aerie.Base.Store
  alias FleetWeb.Console.Access

  # Each vehicle changes once in a round, a slice of them at a time.
  @slices 10
  @slice_ms 20
  # Twice a second, at another place of the round each time.
  @mode_slices 23
  @settle_ms 2_000
  @defaults [vehicles: "10,50,200", viewers: "0,1,5,20", seconds: 10, browser: false, out: ""]

  def main(argv) do
    options = MavCodec.Bench.Options.read(__ENV__.file, argv, @defaults)
    dir = Path.join(System.tmp_dir!(), "console-bench-#{System.pid()}")
    File.mkdir_p!(dir)
    {:ok, peer, _node} = peer()

    try do
      bench = Map.merge(start(dir), %{peer: peer, seconds: options[:seconds], browser: options[:browser]})

      IO.puts("""

      | vehicles | viewers | Hz | CPU % | CPU % each | kB/s each | mode: p50 / p99 / max ms | numbers: p50 / p99 / max ms | DOM: p50 / p99 / max ms |
      |---|---|---|---|---|---|---|---|---|\
      """)

      rows =
        for vehicles <- numbers(options[:vehicles]) do
          for %{key: key} <- Store.vehicles(bench.gateway), do: Store.delete_vehicle(bench.gateway, key)

          options[:viewers]
          |> numbers()
          |> Enum.map_reduce(nil, &measure(Map.merge(bench, %{vehicles: vehicles, viewers: &1, idle: &2})))
          |> elem(0)
        end

      if options[:out] != "", do: File.write!(options[:out], JSON.encode!(List.flatten(rows)))

      IO.puts("\n#{System.schedulers_online()} schedulers of the gateway, load #{load()} at the end")
    after
      :peer.stop(peer)
      File.rm_rf!(dir)
    end
  end

  defp numbers(text), do: text |> String.split(",") |> Enum.map(&String.to_integer/1)
  defp load, do: "/proc/loadavg" |> File.read!() |> String.split() |> hd()

  # The viewers' VM, over its standard input and output.
  defp peer do
    paths = Enum.flat_map(:code.get_path(), &[~c"-pa", &1])
    {:ok, peer, node} = :peer.start(%{connection: :standard_io, args: paths})
    {:ok, _apps} = :peer.call(peer, :application, :ensure_all_started, [:elixir], 60_000)
    file = Path.expand("support/console_viewer.ex", __DIR__)
    [_compiled] = :peer.call(peer, Code, :compile_file, [file], 60_000)
    {:ok, peer, node}
  end

  defp start(dir) do
    gateway = make_ref()

    {:ok, config} =
      Aerie.Config.load(nil, %{
        "nats" => %{"mode" => "off"},
        "mavlink" => %{"local_addr" => "off"},
        "sockets" => %{"enabled" => false},
        "clients" => [],
        "http" => %{"port" => 0},
        "websocket" => %{"enabled" => false},
        "console" => %{"dir" => Path.join(dir, "console")},
        "recorder" => %{"dir" => Path.join(dir, "recordings")},
        "policy" => %{"audit" => %{"dir" => Path.join(dir, "audit")}},
        "commands" => %{"ledger" => %{"dir" => Path.join(dir, "ledger")}}
      })

    {:ok, _gateway} = Aerie.Gateway.start_link(name: gateway, config: config)

    {:ok, _endpoint} =
      FleetWeb.Endpoint.start_link(gateway: gateway, settings: FleetWeb.Settings.from(config))

    {:ok, secret} = Access.Secret.load(gateway, Path.join(dir, "console"))
    session = Phoenix.LiveView.Cookie.with_csrf(Access.Session.of_launch(gateway))
    cookie = Access.Session.cookie(secret) <> "=" <> Phoenix.LiveView.Token.sign(secret, "cookie", session)
    %{gateway: gateway, port: FleetWeb.Endpoint.port(gateway), cookie: cookie}
  end

  # Gives the row for a picture, and the CPU without viewers, to be taken off the next ones'.
  defp measure(%{gateway: gateway, viewers: viewers, seconds: seconds} = bench) do
    marks = for n <- 1..bench.vehicles, into: %{}, do: {n, {now(), now()}}
    for n <- 1..bench.vehicles, do: put(gateway, n, marks)
    until = System.os_time(:millisecond) + @settle_ms + seconds * 1000

    tasks =
      for _viewer <- 1..viewers//1 do
        Task.async(fn ->
          :peer.call(
            bench.peer,
            ConsoleBench.Viewer,
            :run,
            [bench.port, bench.cookie, until],
            (seconds + 60) * 1000
          )
        end)
      end

    page = Task.async(fn -> page(bench, until) end)

    # Until all have come.
    {marks, _slices} = drive(bench, marks, 0, System.os_time(:millisecond) + @settle_ms)
    {before, _since} = :erlang.statistics(:runtime)
    {_marks, slices} = drive(bench, marks, 0, until)
    {after_all, _since} = :erlang.statistics(:runtime)
    sums = Task.await_many(tasks, 120_000)

    percent = (after_all - before) / (seconds * 10)
    idle = if viewers == 0, do: percent, else: bench.idle
    each = if viewers > 0 and idle != nil, do: round1((percent - idle) / viewers), else: "–"
    bytes = if viewers > 0, do: sums |> Enum.map(& &1.bytes) |> Enum.sum() |> div(viewers)
    rate = if bytes, do: round1(bytes / (seconds + @settle_ms / 1000) / 1000), else: "–"
    late = for name <- [:mode, :numbers], do: sums |> Enum.flat_map(& &1[name]) |> quantiles()

    IO.puts(
      "| #{bench.vehicles} | #{viewers} | #{round1(slices / @slices / seconds)} | #{round1(percent)} | #{each} | #{rate} | #{Enum.join(late, " | ")} | " <>
        "#{quantiles(Task.await(page, 120_000))} |"
    )

    {%{
       vehicles: bench.vehicles,
       viewers: viewers,
       cpu: percent,
       mode_p99_ms: sums |> Enum.flat_map(& &1.mode) |> quantile(0.99)
     }, idle}
  end

  # What a page in Chromium measures, microseconds.
  defp page(%{browser: true} = bench, until) do
    script = Path.expand("support/console_page.mjs", __DIR__)

    {output, 0} =
      Aerie.Browser.run(script, ["http://127.0.0.1:#{bench.port}", bench.cookie, Integer.to_string(until)])

    output |> String.split("\n", trim: true) |> List.last() |> JSON.decode!()
  end

  defp page(_none, _until), do: []

  defp quantiles([]), do: "–"

  defp quantiles(late), do: Enum.map_join([0.5, 0.99, 1.0], " / ", &(late |> quantile(&1) |> to_string()))

  # In milliseconds.
  defp quantile([], _share), do: nil

  defp quantile(late, share) do
    sorted = Enum.sort(late)
    sorted |> Enum.at(min(length(sorted) - 1, trunc(length(sorted) * share))) |> div(1000)
  end

  defp round1(number), do: Float.round(number * 1.0, 1)
  defp now, do: System.os_time(:microsecond)

  # One slice of the vehicles after the other, until the time has come; gives the number of slices, too.
  defp drive(%{gateway: gateway, vehicles: vehicles} = bench, marks, slice, until) do
    begun = System.monotonic_time(:millisecond)
    round = div(slice, @slices)

    marks =
      Enum.reduce(1..vehicles, marks, fn n, marks ->
        if rem(n, @slices) == rem(slice, @slices) do
          # The numbers of each fifth vehicle can be told by the time that they have.
          marks =
            if rem(div(n, @slices) + n + round, 5) == 0,
              do: Map.update!(marks, n, &put_elem(&1, 1, now())),
              else: marks

          put(gateway, n, marks)
          marks
        else
          marks
        end
      end)

    marks =
      if rem(slice, @mode_slices) == 0 do
        n = rem(slice, vehicles) + 1
        marks = Map.update!(marks, n, &put_elem(&1, 0, now()))
        put(gateway, n, marks)
        marks
      else
        marks
      end

    Process.sleep(max(0, @slice_ms - (System.monotonic_time(:millisecond) - begun)))

    if System.os_time(:millisecond) < until,
      do: drive(bench, marks, slice + 1, until),
      else: {marks, slice + 1}
  end

  defp put(gateway, n, marks) do
    {mode, numbers} = Map.fetch!(marks, n)
    now = now()
    turn = rem(div(now, 1_000), 100_000) / 100_000

    groups = %{
      position: %{
        lat: 47.0 + n / 1000 + turn / 100,
        lon: 8.0 + turn / 100,
        alt_msl: 500.0 + turn,
        alt_rel: 20.0 + turn,
        heading: turn * 360
      },
      attitude: %{roll: turn, pitch: turn, yaw: turn * 360},
      velocity: %{
        groundspeed: 5 + turn,
        airspeed: 5 + turn,
        climb: turn,
        vn: turn,
        ve: turn,
        vd: turn,
        throttle: 0.5
      },
      battery: %{id: 0, voltage: 22.0 + turn, current: 10 + turn, remaining: 0.7, batteries: []},
      gps: %{fix: 3, fix_name: "3D_FIX", satellites: 14, hdop: 0.8},
      mode: %{mode: "M#{mode}", armed: true, in_air: true, failsafe: false}
    }

    id = "V-#{String.pad_leading("#{n}", 3, "0")}"

    Store.put_vehicle(gateway, {"main", n}, %{
      id: id,
      key: {"main", n},
      network: "main",
      system_id: n,
      autopilot: :ardupilot,
      vehicle_type: "copter",
      firmware: "N#{numbers}",
      status: :online,
      last_heard: now,
      links: [],
      groups: Map.new(groups, fn {name, data} -> {name, %{at: now, time_boot_ms: 1, data: data}} end)
    })
  end
end

ConsoleBench.main(System.argv())
