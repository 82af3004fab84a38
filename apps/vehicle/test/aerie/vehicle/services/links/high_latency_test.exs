defmodule Aerie.Vehicle.Services.Links.HighLatencyTest do
  use ExUnit.Case, async: true

  import Aerie.Flight, only: [frame: 2, options: 1]

  alias Aerie.Vehicle.Session.Core
  alias Aerie.Vehicle.Services.Links.HighLatency
  alias MavCodec.Messages, as: M

  @second 1_000_000
  @copter %M.Heartbeat{type: 2, autopilot: 3, base_mode: 81, custom_mode: 4, system_status: 3}
  @summary %M.HighLatency2{type: 2, autopilot: 3, latitude: 473_977_415, longitude: 85_455_929, battery: 80}

  # Steps `{link, message, second}` or `{:tick, second}` or any event of the core; all actions, the oldest first.
  defp run(steps, options \\ []) do
    {actions, core} =
      Enum.flat_map_reduce(steps, Core.new(options(options)), fn step, core ->
        event =
          case step do
            {:tick, second} -> {:tick, round(second * @second)}
            {:link, _, _} = event -> event
            {link, message, second} -> {:frames, link, [frame(message, round(second * @second))]}
          end

        {core, actions} = Core.handle(core, event)
        {Enum.map(actions, &{elem(step, tuple_size(step) - 1), &1}), core}
      end)

    {actions, core}
  end

  defp ticks(range), do: for(second <- range, tenth <- 0..9, do: {:tick, second + tenth / 10})
  defp sent(actions), do: for({at, {:send, message, _version}} <- actions, do: {at, message})
  defp beats(actions), do: for({at, {:heartbeat, _version}} <- actions, do: at)
  defp statuses(actions), do: for({at, {:status, _old, new}} <- actions, do: {at, new})

  describe "a high-latency link" do
    test "X6: is one by which summaries come and no heartbeat" do
      high =
        HighLatency.new()
        |> HighLatency.summary("sat", 10 * @second)
        |> HighLatency.heartbeat("radio", 10 * @second)

      assert HighLatency.links(high) == ["sat"]
      refute HighLatency.high_latency?(high, "radio")
      # ArduPilot can stream it like any other message.
      both = HighLatency.summary(high, "radio", 11 * @second)
      refute HighLatency.high_latency?(both, "radio")
      refute both |> HighLatency.heartbeat("sat", 12 * @second) |> HighLatency.high_latency?("sat")
    end

    test "is one that is configured so, before anything is heard" do
      assert HighLatency.new() |> HighLatency.configured("sat", true) |> HighLatency.high_latency?("sat")
      refute HighLatency.new() |> HighLatency.configured("radio", false) |> HighLatency.high_latency?("radio")
    end

    test "is one of a bounded number" do
      high = Enum.reduce(1..100, HighLatency.new(), &HighLatency.summary(&2, &1, &1))
      assert map_size(high.links) == 32
    end
  end

  describe "a vehicle behind a satellite" do
    test "X6: is sent nothing at all" do
      steps = [{"sat", @summary, 10} | ticks(11..40)] ++ [{"sat", @summary, 41} | ticks(42..90)]
      {actions, core} = run(steps)
      assert {sent(actions), beats(actions), statuses(actions)} == {[], [], []}
      assert %{only?: true, links: ["sat"]} = Core.snapshot(core).high_latency
      assert %{status: :online, groups: %{position: %{data: %{lat: 47.3977415}}}} = Core.snapshot(core)
    end

    test "nor by a link that is configured so, even if it brings heartbeats" do
      steps = [{:link, "sat", %{high_latency: true}}, {"sat", @copter, 10}] ++ ticks(11..14)
      {actions, core} = run(steps, stale_us: 100 * @second, lost_us: 100 * @second)
      assert {sent(actions), beats(actions)} == {[], []}
      assert Core.snapshot(core).high_latency.only?
    end

    test "is not answered there, but on a radio" do
      request = %M.Timesync{tc1: 0, ts1: 7}
      {actions, _core} = run([{"sat", @summary, 10}, {"sat", request, 11}], timesync_us: 0)
      assert sent(actions) == []
      {actions, _core} = run([{"radio", @copter, 10}, {"radio", request, 11}], timesync_us: 0)
      assert [{11, %M.Timesync{ts1: 7, tc1: 11_000_000_000}}] = sent(actions)
    end

    test "is lost after minutes, and not stale before" do
      {actions, _core} = run([{"sat", @summary, 10} | ticks(11..200)])
      assert [{at, :lost}] = statuses(actions)
      assert_in_delta at, 190, 0.2
    end
  end

  test "a vehicle with both is reached by radio; when that fails it is kept by the satellite link" do
    steps = for second <- 10..20, do: {"radio", @copter, second}
    {actions, core} = run([{"sat", @summary, 10.5} | steps])
    assert beats(actions) != []
    assert Core.Services.link(core) == {:link, "radio"}
    {actions, core} = run([{"sat", @summary, 10.5} | steps] ++ ticks(21..150))
    # Requests end when the radio counts as lost; heartbeats are sent there until it is forgotten.
    assert Enum.all?(sent(actions), fn {at, _message} -> at <= 25.1 end)
    assert Enum.all?(beats(actions), &(&1 < 82))
    assert Core.Services.link(core) == :none
    assert Enum.all?(statuses(actions), fn {_at, status} -> status != :lost end)
    assert Core.snapshot(core).high_latency.only?
  end

  test "a core restored from its snapshot knows its high-latency links" do
    {_actions, core} = run([{"sat", @summary, 10}])
    rebuilt = Core.new(options([]), Core.snapshot(core))
    {_core, actions} = Core.handle(rebuilt, {:tick, 12 * @second})
    assert for({:heartbeat, _} <- actions, do: 1) == []
  end

  test "X6: what such a link carries" do
    carried = [
      %M.CommandLong{command: 400},
      %M.CommandInt{command: 192},
      %M.CommandAck{},
      %M.SetMode{},
      @summary
    ]

    not_carried = [
      @copter,
      %M.ParamRequestList{},
      %M.ParamSet{},
      %M.MissionCount{},
      %M.MissionItemInt{},
      %M.Timesync{},
      %M.RequestDataStream{},
      %M.CommandLong{command: 511},
      %M.CommandLong{command: 512},
      %M.ManualControl{}
    ]

    for message <- carried,
        do: assert(MavCodec.Meaning.HighLatency.carries?(frame(message, 1)), inspect(message))

    for message <- not_carried,
        do: refute(MavCodec.Meaning.HighLatency.carries?(frame(message, 1)), inspect(message))
  end

  test "MAV_CMD_CONTROL_HIGH_LATENCY" do
    assert %M.CommandLong{command: 2600, param1: 1.0, target_system: 7, target_component: 1} =
             HighLatency.control({7, 1}, true)

    assert %M.CommandLong{param1: +0.0} = HighLatency.control({7, 1}, false)
    assert HighLatency.request(make_ref(), {"main", 1}, true) == {:error, :unknown}
  end
end
