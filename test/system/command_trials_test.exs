defmodule Aerie.System.CommandTrialsTest do
  @moduledoc """
  Every command of the table against simulated ArduPilot and PX4, by Aerie's own interface and by pymavlink and MAVSDK
  through the gateway: its answer, and what the vehicle heard and did. Then the same commands from clients and a source
  that may only look on: each is refused and answered, and the vehicle hears none of them.
  """

  use Aerie.SystemCase, async: true

  import Aerie.PeerCase, only: [ask: 2, start_peer: 2]

  alias Aerie.CommandTrials
  alias Aerie.Control.{Commands, Missions}
  alias Aerie.Vehicle.Command.Types

  @moduletag :tmp_dir
  @moduletag :capture_log

  @crew %{name: "crew", role: :admin, permissions: [:force_disarm, :terminate]}
  @guest %{name: "guest", role: :viewer, permissions: []}
  @denied 2
  @page Path.expand("../../docs/commands.md", __DIR__)

  defp fly(context, way) do
    {:ok, plan} = Missions.import(CommandTrials.plan(), :waypoints)
    {:ok, %{status: :completed}} = Missions.upload(context.gateway, "VID-001", :mission, plan)
    :ok = SimVehicle.subscribe(context.sim)
    rows = for row <- CommandTrials.rows(context.firmware), way.tries?.(row), do: row
    Enum.each(rows, &try_row(&1, context, way))
  end

  defp try_row(row, context, way) do
    forget_heard()
    {answer, expected} = way.try.(row, context)
    assert {row.type, answer} == {row.type, expected}

    if way.done?.(row) do
      if row.hears && !row.does, do: assert_heard(%{row | hears: way.hears.(row)})
      if row.does, do: assert(SimVehicle.await(context.sim, row.does), row.type)
    end

    %{seconds: now} = SimVehicle.state(context.sim)
    SimVehicle.await(context.sim, &(&1.seconds >= now + row.lasts_s))
  end

  defp start(context, firmware, speed \\ 5.0) do
    policy = %{
      "clients" => [
        %{"id" => "crew", "role" => "admin", "permissions" => ["force_disarm", "terminate"]},
        %{"id" => "guest", "role" => "viewer"}
      ]
    }

    clients = for id <- ~w(crew guest), do: %{"id" => id, "url" => "tcpin:127.0.0.1:0"}
    # PX4 sends its texts, calibration's among them, only while it hears a ground station.
    mavlink = %{"local_addr" => "off", "i_am_the_gcs" => true, "heartbeat_type" => "gcs"}
    overrides = %{"policy" => policy, "clients" => clients, "mavlink" => mavlink, "timeouts" => patient()}
    %{gateway: gateway} = start_gateway(context.tmp_dir, links: ["udpin:127.0.0.1:0"], overrides: overrides)
    link = "udpout:127.0.0.1:#{link_port(gateway, "link-1")}"

    # Each obeys our sticks only if a parameter says so.
    # A peer that stands still for a moment is none that has gone, although time passes faster for the vehicle (X7).
    patient =
      if firmware == :px4,
        do: %{"COM_OF_LOSS_T" => 60.0, "COM_RC_IN_MODE" => 2},
        else: %{"GUID_TIMEOUT" => 60.0, "SYSID_MYGCS" => 237}

    fast = Keyword.put(fast_vehicle(firmware, patient), :speed, speed)
    sim = start_supervised!({SimVehicle, [link: link] ++ fast})
    SimVehicle.await(sim, & &1.ready)
    await_standing(gateway)
    %{gateway: gateway, sim: sim, firmware: firmware}
  end

  defp address(gateway, id, scheme) do
    port = eventually(fn -> MavRouter.Link.snapshot(gateway, id).port end, "the endpoint #{id} is open")
    "#{scheme}127.0.0.1:#{port}"
  end

  # A reboot shows in the vehicle's clock, which must run as ours does: commands_test.exs.
  defp own_interface do
    %{
      tries?: &(&1.type != "reboot"),
      done?: &(&1.own in [:accepted, :completed]),
      try: fn row, context -> {answer(context, row), row.own} end,
      hears: & &1.hears
    }
  end

  # On a busy machine an answer may come too late, and a command that must not be repeated blindly is then unknown. Once
  # more, as a person would.
  defp answer(context, %{own: own} = row) do
    case submit(context, row, @crew).status do
      :unknown when own != :unknown ->
        # ArduPilot refuses a take-off in the air.
        if row.type == "takeoff" and SimVehicle.state(context.sim).airborne,
          do: own,
          else: submit(context, row, @crew).status

      status ->
        status
    end
  end

  defp submit(%{gateway: gateway}, row, source) do
    {:ok, result} =
      Commands.submit(gateway,
        vehicle: "VID-001",
        type: row.type,
        params: row.params,
        as: source,
        # Ten seconds, the usual deadline, are too few on a busy machine.
        deadline: System.os_time(:second) + 120
      )

    result
  end

  defp pymavlink(peer) do
    %{
      tries?: fn _row -> true end,
      done?: &(&1.ack in [0, nil]),
      try: fn row, _context -> {ask(peer, Map.put(row.raw, "silent", row.ack == nil))["ack"], row.ack} end,
      hears: & &1.hears
    }
  end

  defp mavsdk(peer) do
    %{
      tries?: &method?/1,
      done?: &(&1.result == "SUCCESS"),
      try: fn row, _context -> {prepared(peer, row), row.result} end,
      hears: &(&1.mavsdk_hears || &1.hears)
    }
  end

  defp method?(row), do: not match?({:no, _reason}, row.mavsdk)

  # What comes before a call may be late (MAVSDK's download gives up after a second or two), and the call is then
  # refused by MAVSDK itself.
  defp prepared(peer, %{mavsdk: [_before, _call]} = row) do
    eventually(fn -> call(peer, row) == row.result end, "#{row.type}: MAVSDK gets #{row.result}")
    row.result
  end

  defp prepared(peer, row), do: call(peer, row)

  # The answer to the last one counts.
  defp call(peer, row) do
    row.mavsdk
    |> List.wrap()
    |> Enum.map(fn
      {method, arguments} -> ask(peer, %{"call" => method, "args" => arguments})["result"]
      method -> ask(peer, %{"call" => method, "args" => []})["result"]
    end)
    |> List.last()
  end

  defp forget_heard do
    receive do
      {:sim, _sim, _event} -> forget_heard()
    after
      0 -> :ok
    end
  end

  defp assert_heard(row) do
    eventually(
      fn ->
        receive do
          {:sim, _sim, {:heard, message, _source}} -> heard?(row, message)
        after
          0 -> false
        end
      end,
      "#{row.type}: the vehicle hears #{row.hears}"
    )
  end

  defp heard?(%{hears: command}, %{command: command}), do: true

  defp heard?(%{hears: name}, %module{}) when is_binary(name),
    do: module.id() == MavCodec.Dialects.All.message_id(String.upcase(name))

  defp heard?(_row, _message), do: false

  test "the trials have every command of the table; docs/commands.md shows them" do
    for firmware <- [:ardupilot, :px4] do
      tried = firmware |> CommandTrials.rows() |> Enum.map(& &1.type)
      assert Types.names() -- tried == [], "#{firmware}"
      assert Enum.reject(tried, &(&1 in Types.names())) == []
    end

    assert File.read!(@page) == CommandTrials.page(), "renew it as Aerie.CommandTrials.write/0 says"
  end

  for firmware <- [:ardupilot, :px4] do
    test "#{firmware}: Aerie's own interface", context do
      # Its set-points come ten times a second, and PX4 wants two in a second of its own (X7).
      context |> start(unquote(firmware), 3.0) |> fly(own_interface())
    end

    @tag :python
    @tag :long
    test "#{firmware}: pymavlink through the gateway", context do
      flight = start(context, unquote(firmware), 3.0)
      peer = start_peer("pymavlink_commands.py", [address(flight.gateway, "crew", "tcp:"), 1])
      fly(flight, pymavlink(peer))
    end

    @tag :mavsdk
    @tag :long
    test "#{firmware}: MAVSDK through the gateway", context do
      # Its set-points come 20 times a second, and PX4 wants two in a second of its own (X7).
      flight = start(context, unquote(firmware), 3.0)
      peer = start_peer("mavsdk_commands.py", [address(flight.gateway, "crew", "tcpout://"), 1])
      fly(flight, mavsdk(peer))
    end

    test "#{firmware}: Aerie's own interface, for a viewer", context do
      flight = start(context, unquote(firmware))

      for row <- CommandTrials.rows(unquote(firmware)) do
        assert %{status: :denied, details: %{"rule" => "role"}} = submit(flight, row, @guest), row.type
      end
    end

    @tag :python
    @tag :long
    test "#{firmware}: pymavlink that only looks on", context do
      flight = start(context, unquote(firmware))
      peer = start_peer("pymavlink_commands.py", [address(flight.gateway, "guest", "tcp:"), 1])
      :ok = SimVehicle.subscribe(flight.sim)

      for %{raw: raw} = row <- moving_rows(unquote(firmware)) do
        if is_map_key(raw, "send"),
          do:
            assert(%{"text" => "refused: " <> _reason} = ask(peer, Map.put(raw, "refused", true)), row.type),
          else: assert({row.type, @denied} == {row.type, ask(peer, raw)["ack"]})
      end

      assert_unheard(flight, {255, 190})
    end

    @tag :mavsdk
    @tag :long
    test "#{firmware}: MAVSDK that only looks on", context do
      flight = start(context, unquote(firmware))
      peer = start_peer("mavsdk_commands.py", [address(flight.gateway, "guest", "tcpout://"), 1])
      :ok = SimVehicle.subscribe(flight.sim)

      for row <- moving_rows(unquote(firmware)), method?(row) do
        result = call(peer, row)
        if not is_map_key(row.raw, "send"), do: assert({row.type, result} != {row.type, "SUCCESS"})
      end

      assert_unheard(flight, {245, 190})
    end
  end

  # Every client may ask for a message.
  defp moving_rows(firmware),
    do: for(row <- CommandTrials.rows(firmware), row.type != "request_message", do: row)

  # What was forwarded before this command has reached the vehicle before it.
  defp assert_unheard(flight, source) do
    ask = %{type: "request_message", params: %{message_id: 148}}
    assert %{status: :completed} = submit(flight, ask, @crew)
    rows = moving_rows(flight.firmware)
    assert [] == for(message <- heard(source), Enum.any?(rows, &heard?(&1, message)), do: message)
  end

  defp heard(source) do
    receive do
      {:sim, _sim, {:heard, message, ^source}} -> [message | heard(source)]
    after
      0 -> []
    end
  end
end
