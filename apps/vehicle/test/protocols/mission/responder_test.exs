defmodule Protocols.Mission.ResponderTest do
  use ExUnit.Case, async: true

  alias Protocols.Mission.{Item, Responder, Result}
  alias Aerie.Vehicle.Firmware
  alias MavCodec.Messages, as: M

  @gcs {255, 190}
  @other {254, 190}

  defp fresh?(served, type), do: is_map_key(served.plans, type)

  defp items(count, salt \\ 0),
    do: for(n <- 1..count//1, do: %Item{command: 16, frame: 3, x: n, y: salt, z: 10.0})

  defp read(served, type, items, opaque_id, now, began \\ nil) do
    result = %Result{
      status: :completed,
      on_board: :read,
      items: items,
      opaque_id: opaque_id,
      read_at: began || now
    }

    Responder.handle(served, {:read, type, result, now})
  end

  defp served(protocol \\ Firmware.Px4.Adapter, items \\ items(3)) do
    {served, []} = protocol |> Responder.new() |> read(0, items, 77, 0)
    served
  end

  defp station(served, message, from \\ @gcs, now \\ 1),
    do: Responder.handle(served, {:station, message, from, now})

  defp vehicle(served, message), do: served |> Responder.handle({:vehicle, message, 1}) |> elem(0)

  test "a plan that is known is read from here, item by item, by any number of stations" do
    for n <- 1..20, reduce: served() do
      served ->
        from = {n, 190}
        {served, [{:reply, count}]} = station(served, %M.MissionRequestList{}, from)
        assert %M.MissionCount{count: 3, target_system: ^n, target_component: 190, opaque_id: 77} = count

        served =
          for seq <- 0..2, reduce: served do
            served ->
              request =
                if rem(seq, 2) == 0, do: %M.MissionRequestInt{seq: seq}, else: %M.MissionRequest{seq: seq}

              # W5
              {served, [{:reply, item}]} = station(served, request, from)
              assert %M.MissionItemInt{seq: ^seq, target_system: ^n} = item
              assert Item.read(item) == Enum.at(items(3), seq)
              served
          end

        {served, [{:reply, %M.MissionAck{type: 13}}]} = station(served, %M.MissionRequestInt{seq: 3}, from)
        {served, []} = station(served, %M.MissionAck{type: 0}, from)
        assert served.readers == %{}
        served
    end
  end

  test "an unknown plan is read once, for all who ask meanwhile" do
    served = Responder.new(Firmware.Px4.Adapter)
    {served, [{:fetch, 1}]} = station(served, %M.MissionRequestList{mission_type: 1})
    {served, []} = station(served, %M.MissionRequestList{mission_type: 1})
    {served, []} = station(served, %M.MissionRequestList{mission_type: 1}, @other)
    # W4: another type is another plan.
    {served, [{:fetch, 0}]} = station(served, %M.MissionRequestList{})

    {served, replies} = read(served, 1, items(2), nil, 2)

    assert [254, 255] =
             for({:reply, %M.MissionCount{count: 2, mission_type: 1} = m} <- replies, do: m.target_system)
             |> Enum.sort()

    assert {_served, [{:reply, %M.MissionItemInt{}}]} =
             station(served, %M.MissionRequestInt{seq: 1, mission_type: 1}, @other, 3)

    assert fresh?(served, 1) and not fresh?(served, 0)
  end

  test "if it cannot be read the vehicle is asked by the stations themselves" do
    list = %M.MissionRequestList{}
    {served, [{:fetch, 0}]} = station(Responder.new(Firmware.Px4.Adapter), list)
    assert {served, [{:forward, ^list, @gcs}]} = Responder.handle(served, {:unread, 0, 2})
    request = %M.MissionRequestInt{seq: 0}
    assert {served, [{:forward, ^request, @gcs}]} = station(served, request)
    ack = %M.MissionAck{type: 0}
    assert {_served, [{:forward, ^ack, @gcs}]} = station(served, ack)
  end

  test "what writes goes to the vehicle, and makes the plan stale" do
    for message <- [
          %M.MissionCount{count: 2},
          %M.MissionItemInt{},
          %M.MissionClearAll{},
          %M.MissionClearAll{mission_type: 255},
          %M.MissionWritePartialList{}
        ] do
      {served, [{:forward, ^message, @other}]} = station(served(), message, @other)
      refute fresh?(served, 0)
    end

    # Another type's plan, and what writes nothing, does not.
    for message <- [%M.MissionCount{count: 2, mission_type: 1}, %M.MissionSetCurrent{seq: 1}] do
      {served, [{:forward, _message, _from}]} = station(served(), message)
      assert fresh?(served, 0)
    end
  end

  test "what the vehicle says may make it stale" do
    for message <- [
          %M.MissionCurrent{mission_id: 78},
          %M.MissionCurrent{mission_id: 0, total: 65_535},
          %M.MissionAck{type: 0, target_system: 250},
          %M.MissionCount{count: 4, target_system: 250},
          %M.MissionCount{count: 3, opaque_id: 79}
        ],
        do: refute(fresh?(vehicle(served(), message), 0))

    for message <- [
          %M.MissionCurrent{mission_id: 77, fence_id: 5},
          %M.MissionAck{type: 1},
          %M.MissionCount{count: 3, opaque_id: 77},
          %M.MissionCount{count: 3},
          %M.Heartbeat{},
          %M.HomePosition{latitude: 5, longitude: 5}
        ],
        do: assert(fresh?(vehicle(served(), message), 0))

    {rebooted, []} = Responder.handle(served(), {:rebooted, 1})
    refute fresh?(rebooted, 0)
    {changing, []} = Responder.handle(served(), {:written, 0, 1})
    refute fresh?(changing, 0)
  end

  test "without ids the total tells" do
    {served, []} = read(Responder.new(Firmware.Ardupilot.Adapter), 0, items(3), nil, 0)
    served = vehicle(served, %M.MissionCurrent{total: 2})
    assert fresh?(vehicle(served, %M.MissionCurrent{total: 2}), 0)
    refute fresh?(vehicle(served, %M.MissionCurrent{total: 5}), 0)
  end

  test "ArduPilot's item 0 is home: another one makes the mission stale" do
    home = %Item{command: 16, frame: 0, x: -353_632_610, y: 1_491_652_299, z: 584.09}
    served = served(Firmware.Ardupilot.Adapter, [home | items(2)])
    same = %M.HomePosition{latitude: -353_632_609, longitude: 1_491_652_299, altitude: 584_090}
    assert fresh?(vehicle(served, same), 0)
    refute fresh?(vehicle(served, %{same | latitude: -353_632_000}), 0)
    refute fresh?(vehicle(served, %{same | altitude: 586_000}), 0)
  end

  test "a station never gets items of two plans" do
    {served, [{:reply, %M.MissionCount{}}]} = station(served(), %M.MissionRequestList{})
    {served, [{:reply, %M.MissionItemInt{}}]} = station(served, %M.MissionRequestInt{seq: 0})
    {served, []} = read(served, 0, items(3, 9), 78, 2)
    # W6
    {served, [{:reply, %M.MissionAck{type: 15}}]} = station(served, %M.MissionRequestInt{seq: 1})
    {served, [{:reply, %M.MissionCount{opaque_id: 78}}]} = station(served, %M.MissionRequestList{})
    {_served, [{:reply, %M.MissionItemInt{y: 9}}]} = station(served, %M.MissionRequestInt{seq: 1})
  end

  test "stations that have gone are forgotten, and there are never too many" do
    served =
      for n <- 1..250, component <- [1, 2], reduce: served() do
        served -> served |> station(%M.MissionRequestList{}, {n, component}, n * 1000) |> elem(0)
      end

    assert map_size(served.readers) <= 192

    {served, _} = station(served(), %M.MissionRequestList{}, @gcs, 1)

    assert {_served, [{:reply, %M.MissionAck{type: 15}}]} =
             station(served, %M.MissionRequestInt{seq: 0}, @gcs, 40_000_000)

    waiting =
      for n <- 1..100, reduce: Responder.new(Firmware.Px4.Adapter) do
        served -> served |> station(%M.MissionRequestList{}, {n, 1}) |> elem(0)
      end

    assert map_size(waiting.fetching[0]) == 64
  end

  test "whatever happens, what is served is the vehicle's last plan that was read, and only while nothing changed it" do
    event =
      :proper_types.oneof([
        :list,
        :list,
        {:request, :proper_types.integer(0, 4)},
        {:request, :proper_types.integer(0, 4)},
        :write,
        {:read, :proper_types.integer(0, 3)},
        {:read, :proper_types.integer(0, 3)},
        :change,
        :reboot
      ])

    property =
      :proper.forall(:proper_types.list(event), fn events ->
        # The vehicle's plan has a number, which is the salt of its items. A reading may be of the plan when it began.
        plans =
          Enum.scan([:start | events], 1, fn event, plan ->
            if event in [:write, :change], do: plan + 1, else: plan
          end)

        {_served, _began, ok?} =
          events
          |> Enum.with_index(1)
          |> Enum.reduce({Responder.new(Firmware.Px4.Adapter), nil, true}, fn {event, now},
                                                                              {served, began, ok?} ->
            plan = Enum.at(plans, now)

            case event do
              :list ->
                {served, actions} = station(served, %M.MissionRequestList{}, @gcs, now)
                began = if match?([{:reply, _count}], actions), do: plan, else: began
                {served, began, ok? and Enum.all?(actions, &current?(&1, plan, plan))}

              {:request, seq} ->
                {served, actions} = station(served, %M.MissionRequestInt{seq: seq}, @gcs, now)
                {served, began, ok? and Enum.all?(actions, &current?(&1, plan, began))}

              :write ->
                {served, [{:forward, _, _}]} = station(served, %M.MissionCount{count: 1}, @other, now)
                {served, began, ok?}

              {:read, ago} ->
                then = max(now - ago, 0)
                old = Enum.at(plans, then)
                {served, actions} = read(served, 0, items(3, old), old, now, then)
                began = if match?([{:reply, _count}], actions), do: plan, else: began
                {served, began, ok? and Enum.all?(actions, &current?(&1, plan, plan))}

              # By somebody on another way; MISSION_CURRENT says so.
              :change ->
                {Responder.handle(served, {:vehicle, %M.MissionCurrent{mission_id: plan}, now}) |> elem(0),
                 began, ok?}

              :reboot ->
                {served |> Responder.handle({:rebooted, now}) |> elem(0), began, ok?}
            end
          end)

        ok?
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 1000]) == true, inspect(:proper.counterexample())
  end

  test "a reading that began before the plan changed is not served" do
    {served, [{:fetch, 0}]} = station(Responder.new(Firmware.Px4.Adapter), %M.MissionRequestList{}, @gcs, 10)
    {served, [{:forward, _, _}]} = station(served, %M.MissionCount{count: 1}, @other, 20)
    {served, [{:fetch, 0}]} = read(served, 0, items(3), 1, 30, 11)
    refute fresh?(served, 0)
    {_served, [{:reply, %M.MissionCount{count: 2}}]} = read(served, 0, items(2), 2, 50, 31)
  end

  defp current?({:reply, %M.MissionCount{opaque_id: id}}, plan, _began), do: id == plan
  defp current?({:reply, %M.MissionItemInt{y: salt}}, plan, began), do: salt == plan and salt == began
  defp current?(_forward_or_refusal, _plan, _began), do: true
end
