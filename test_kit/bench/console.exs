# What the console's fleet page costs: viewers that each have it open by a WebSocket of their own (compressed, as
# browsers do), and vehicles whose numbers change five times a second, spread over time; twice a second the mode of one
# of them changes, too. The gateway's VM has one scheduler if it is started so (ELIXIR_ERL_OPTIONS="+S 1:1"); the
# viewers are another OS process.
#
#     bin/bench console [--vehicles 10,50,200] [--viewers 0,1,5,20] [--seconds 10] [--browser] [--out FILE]
#
# Prints a table in Markdown: how often each vehicle changed in a second, CPU of the gateway's OS process in per cent
# of one core (all, and what each viewer adds to none), bytes a second that a viewer gets, and the time from a change
# in the store to the frame that has it at the viewer (ms): of a mode, which shows at once, and of numbers, which the
# table of more than 50 vehicles shows less often. With --browser one more viewer is a page in Chromium (without
# WebGL), and the last column is the time until its DOM has the change of a mode. FILE gets the rows as JSON, for
# support/plot.py.

Code.require_file("harness.exs", __DIR__)
Code.require_file("../../test/browser/browser.ex", __DIR__)

defmodule ConsoleBench do
  alias Aerie.Base.Store
  alias Bench.{Gateway, OSProcess, Sample, Table}
  alias Aerie.Access

  # Each vehicle changes once in a round, a slice of them at a time.
  @slices 10
  @slice_ms 20
  # Twice a second, at another place of the round each time.
  @mode_slices 23
  @settle_ms 2_000

  def main(dir, options) do
    bench =
      Map.merge(start(dir), %{
        peer: OSProcess.vm("console_viewer.exs"),
        seconds: options[:seconds],
        browser: options[:browser]
      })

    late = for what <- ~w(mode numbers DOM), do: "#{what}: p50 / p99 / max ms"
    IO.puts("")
    Table.head(["vehicles", "viewers", "Hz", "CPU %", "CPU % each", "kB/s each" | late])

    rows =
      for vehicles <- Bench.Options.numbers(options[:vehicles]), do: rows(bench, vehicles, options[:viewers])

    if options[:out] != "", do: File.write!(options[:out], JSON.encode!(List.flatten(rows)))
    IO.puts("\n#{System.schedulers_online()} schedulers of the gateway, load #{OSProcess.load()} at the end")
    :peer.stop(bench.peer)
  end

  defp rows(bench, vehicles, viewers) do
    for %{key: key} <- Store.vehicles(bench.gateway), do: Store.delete_vehicle(bench.gateway, key)
    step = &measure(Map.merge(bench, %{vehicles: vehicles, viewers: &1, idle: &2}))
    viewers |> Bench.Options.numbers() |> Enum.map_reduce(nil, step) |> elem(0)
  end

  defp start(dir) do
    gateway = make_ref()
    off = [{"nats.mode", "off"}, {"sockets.enabled", false}, {"websocket.enabled", false}, {"http.port", 0}]
    Gateway.whole(gateway, Gateway.config(dir, off), true)
    {:ok, secret} = Access.Session.secret(gateway, Path.join(dir, "console"))
    session = Phoenix.LiveView.Cookie.with_csrf(Access.Session.of_launch(gateway))
    cookie = Access.Session.cookie(secret) <> "=" <> Phoenix.LiveView.Token.sign(secret, "cookie", session)
    %{gateway: gateway, port: Aerie.Api.Endpoint.port(gateway), cookie: cookie}
  end

  # Gives the row for a picture, and the CPU without viewers, to be taken off the next ones'.
  defp measure(%{viewers: viewers, seconds: seconds} = bench) do
    marks = for n <- 1..bench.vehicles, into: %{}, do: {n, {now(), now()}}
    for n <- 1..bench.vehicles, do: put(bench.gateway, n, marks)
    until = System.os_time(:millisecond) + @settle_ms + seconds * 1000

    view = fn ->
      :peer.call(bench.peer, Bench.Viewer, :run, [bench.port, bench.cookie, until], (seconds + 60) * 1000)
    end

    tasks = for _viewer <- 1..viewers//1, do: Task.async(view)
    page = Task.async(fn -> page(bench, until) end)

    # Until all have come.
    {marks, _slices} = drive(bench, marks, 0, System.os_time(:millisecond) + @settle_ms)
    cpu = Sample.cpu()
    {_marks, slices} = drive(bench, marks, 0, until)
    percent = (Sample.cpu() - cpu) / seconds * 100
    sums = Task.await_many(tasks, 120_000)

    idle = if viewers == 0, do: percent, else: bench.idle
    each = if viewers > 0 and idle != nil, do: Sample.round((percent - idle) / viewers)

    rate =
      if viewers > 0,
        do: Sample.round(Enum.sum_by(sums, & &1.bytes) / viewers / (seconds + @settle_ms / 1000) / 1000)

    [modes, numbers] = for name <- [:mode, :numbers], do: Enum.flat_map(sums, & &1[name])
    late = Enum.map([modes, numbers, Task.await(page, 120_000)], &milliseconds/1)
    hz = Sample.round(slices / @slices / seconds)
    Table.row([bench.vehicles, viewers, hz, Sample.round(percent), each, rate | late])
    p99 = if late = milliseconds(modes), do: Enum.at(late, 1)
    {%{vehicles: bench.vehicles, viewers: viewers, cpu: percent, mode_p99_ms: p99}, idle}
  end

  defp milliseconds(late),
    do: with([_ | _] = spread <- Sample.spread(late), do: Enum.map(spread, &div(&1, 1000)))

  # What a page in Chromium measures, microseconds.
  defp page(%{browser: true} = bench, until) do
    script = Path.expand("support/console_page.mjs", __DIR__)

    {output, 0} =
      Aerie.Browser.run(script, ["http://127.0.0.1:#{bench.port}", bench.cookie, Integer.to_string(until)])

    output |> String.split("\n", trim: true) |> List.last() |> JSON.decode!()
  end

  defp page(_none, _until), do: []

  defp now, do: System.os_time(:microsecond)

  # One slice of the vehicles after the other, until the time has come; gives the number of slices as well.
  defp drive(%{vehicles: vehicles} = bench, marks, slice, until) do
    due = System.monotonic_time(:microsecond) + @slice_ms * 1000
    turn = for n <- 1..vehicles, rem(n, @slices) == rem(slice, @slices), do: {n, told?(n, slice) && 1}
    mode = if rem(slice, @mode_slices) == 0, do: [{rem(slice, vehicles) + 1, 0}], else: []

    marks =
      for {n, mark} <- turn ++ mode, reduce: marks do
        marks ->
          marks = if mark, do: Map.update!(marks, n, &put_elem(&1, mark, now())), else: marks
          put(bench.gateway, n, marks)
          marks
      end

    Sample.sleep_until(due)

    if System.os_time(:millisecond) < until,
      do: drive(bench, marks, slice + 1, until),
      else: {marks, slice + 1}
  end

  # The numbers of each fifth vehicle show the time that they have.
  defp told?(n, slice), do: rem(div(n, @slices) + n + div(slice, @slices), 5) == 0

  defp put(gateway, n, marks) do
    {mode, numbers} = Map.fetch!(marks, n)
    now = now()
    turn = rem(div(now, 1_000), 100_000) / 100_000
    place = %{lat: 47.0 + n / 1000 + turn / 100, lon: 8.0 + turn / 100}

    speeds = %{
      groundspeed: 5 + turn,
      airspeed: 5 + turn,
      climb: turn,
      vn: turn,
      ve: turn,
      vd: turn,
      throttle: 0.5
    }

    groups = %{
      position: Map.merge(place, %{alt_msl: 500.0 + turn, alt_rel: 20.0 + turn, heading: turn * 360}),
      attitude: %{roll: turn, pitch: turn, yaw: turn * 360},
      velocity: speeds,
      battery: %{id: 0, voltage: 22.0 + turn, current: 10 + turn, remaining: 0.7, batteries: []},
      gps: %{fix: 3, fix_name: "3D_FIX", satellites: 14, hdop: 0.8},
      mode: %{mode: "M#{mode}", armed: true, in_air: true, failsafe: false}
    }

    Store.put_vehicle(gateway, {"main", n}, %Aerie.Vehicle.Snapshot{
      id: "V-#{String.pad_leading("#{n}", 3, "0")}",
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

defaults = [vehicles: "10,50,200", viewers: "0,1,5,20", seconds: 10, browser: false, out: ""]
options = Bench.Options.read(__ENV__.file, defaults)
Bench.Gateway.in_folder("console", &ConsoleBench.main(&1, options))
