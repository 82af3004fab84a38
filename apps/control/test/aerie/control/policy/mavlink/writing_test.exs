defmodule Aerie.Control.Policy.Mavlink.WritingTest do
  @moduledoc "Plans that are written item by item in whatever order, and missions that are entered (W3, W7)."
  use ExUnit.Case, async: true

  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.Fence.Kept
  alias Aerie.Control.Policy.Mavlink.Review
  alias Aerie.Control.Policy.Roles
  alias Aerie.Control.Policy.Intent.Context
  alias Aerie.Control.Policy.Clients.Trial
  alias Protocols.Mission.Item
  alias MavCodec.Enums.MavCmd
  alias MavCodec.Messages, as: M

  @start 1_795_000_000_000_000
  @second 1_000_000
  # A tower of 100 m in the middle of a field: the straight ways west to east and south to north lead through it.
  @fence """
  {"type": "FeatureCollection", "features": [
    {"type": "Feature", "properties": {"name": "field"},
     "geometry": {"type": "Polygon", "coordinates": [[[8.0, 47.0], [8.03, 47.0], [8.03, 47.02], [8.0, 47.02]]]}},
    {"type": "Feature", "properties": {"name": "tower", "fence": "exclusion", "radius": 100},
     "geometry": {"type": "Point", "coordinates": [8.015, 47.01]}}]}
  """
  @west {47.01, 8.010}
  @east {47.01, 8.020}
  @north {47.015, 8.015}
  @south {47.005, 8.015}

  defp policy do
    {:ok, fence} = Policy.Fence.parse(@fence)
    {:ok, policy} = Policy.compile(%{})
    %{policy | fence: fence}
  end

  defp snapshot(autopilot, place \\ @west, seq \\ 0) do
    {lat, lon} = place
    home = %{lat: 47.01, lon: 8.005, alt_msl: 500.0}
    position = %{lat: lat, lon: lon, alt_rel: 20.0, alt_msl: 520.0}

    %Aerie.Vehicle.Snapshot{
      id: "VID-001",
      key: {"main", 1},
      component: 1,
      autopilot: autopilot,
      vehicle_type: "copter",
      params: %{"WPNAV_RADIUS" => 200.0, "NAV_ACC_RAD" => 2.0},
      groups: %{
        position: position,
        home: home,
        mode: %{mode: "GUIDED", armed: true, in_air: true},
        mission: %{data: %{seq: seq}, at: @start}
      }
    }
  end

  defp asked(snapshot, at \\ 0, role \\ :operator) do
    source = Roles.principal(:client, "olga", role)
    %{snapshot: snapshot, at: @start + at, source: source, sender: "gcs", via: "mavlink"}
  end

  defp place({lat, lon}, seq, fields \\ []),
    do:
      struct!(
        %M.MissionItemInt{
          target_system: 1,
          target_component: 1,
          seq: seq,
          frame: 6,
          command: 16,
          x: round(lat * 1.0e7),
          y: round(lon * 1.0e7),
          z: 20.0
        },
        fields
      )

  defp jump(to, seq), do: place({0, 0}, seq, command: 177, frame: 2, param1: to / 1, param2: 1.0)

  defp count(n, fields \\ []),
    do: struct!(%M.MissionCount{target_system: 1, target_component: 1, count: n}, fields)

  # A vehicle of which nobody knows what is aboard.
  defp unread, do: %{Trial.new(policy()) | aboard: %{{"VID-001", 0} => nil, {"VID-001", 1} => nil}}

  # Decisions about messages, in their order.
  defp decisions(messages, asked) do
    {decisions, _trial} =
      Enum.map_reduce(messages, unread(), fn message, trial ->
        {%{decision: decision}, trial} = Trial.message(trial, message, asked)
        {decision, trial}
      end)

    decisions
  end

  defp last(messages, snapshot, role \\ :operator),
    do: messages |> decisions(asked(snapshot, 0, role)) |> List.last()

  for autopilot <- [:ardupilot, :px4] do
    test "#{autopilot}: a mission is judged whole when its last item comes, whichever that is" do
      vehicle = snapshot(unquote(autopilot))
      # ArduPilot's item 0 is its home.
      whole = [place(@west, 0), place(@west, 1), place(@north, 2), place(@east, 3)]
      assert last([count(4) | whole], vehicle) == :allow
      assert {:deny, :geofence, reason} = last([count(5) | whole] ++ [jump(1, 4)], vehicle)
      assert reason =~ ~s(enters the exclusion zone "tower")
      assert last([count(5) | whole] ++ [jump(2, 4)], vehicle) == :allow

      [home, one, two, three] = whole
      over = [home, one, jump(4, 2), %{two | seq: 3}, %{three | seq: 4}]
      assert {:deny, :geofence, _} = last([count(5) | over], vehicle)
      assert {:deny, :geofence, _} = last([count(5) | Enum.reverse(over)], vehicle)
    end

    test "#{autopilot}: an item that comes again is the same item" do
      vehicle = snapshot(unquote(autopilot))
      [home, one, two] = [place(@west, 0), place(@west, 1), place(@north, 2)]
      again = "mission item 1 came before with another content; begin the upload again"
      begun = [count(4), home, one]
      assert last(begun ++ [one], vehicle) == :allow
      assert last(begun ++ [place(@north, 1)], vehicle) == {:deny, :geofence, again}
      assert last(begun ++ [count(4), home, one, two], vehicle) == :allow
      # The vehicle may not have taken the second beginning.
      assert {:deny, :geofence, reason} = last(begun ++ [count(4), home, place(@north, 1)], vehicle)
      assert reason =~ "begin again in 10 s"

      assert {:deny, :geofence, _} =
               last(begun ++ [count(1, target_component: 77), place(@north, 1)], vehicle)

      assert {:deny, :geofence, _} = last([count(60_000)], vehicle)
    end
  end

  test "a partial write is judged with its neighbours, which have to be known" do
    vehicle = snapshot(:ardupilot)
    whole = [place(@west, 0), place(@west, 1), place(@north, 2), place(@east, 3)]
    part = &%M.MissionWritePartialList{target_system: 1, target_component: 1, start_index: &1, end_index: &2}
    assert {:deny, :geofence, reason} = last([part.(2, 2)], vehicle)
    assert reason =~ "the gateway reads them now"
    known = [count(4) | whole] ++ [part.(2, 2)]
    assert last(known, vehicle) == :allow
    assert last(known ++ [place({47.0151, 8.015}, 2)], vehicle) == :allow
    assert {:deny, :geofence, _} = last(known ++ [place({47.01, 8.011}, 2)], vehicle)
    assert {:deny, :geofence, _} = last(List.replace_at(known, -1, part.(3, 9)), vehicle)
  end

  test "while ArduPilot flies its mission, an item is judged with those of the old one behind it" do
    flying = fn autopilot -> put_in(snapshot(autopilot).groups.mode.mode, "AUTO") end
    old = [place(@west, 0), place(@west, 1), place(@north, 2), place(@east, 3)]

    judge = fn messages, trial, vehicle ->
      Enum.map_reduce(messages, trial, fn message, trial ->
        {%{decision: decision}, trial} = Trial.message(trial, message, asked(vehicle))
        {decision, trial}
      end)
    end

    sent = fn messages, autopilot ->
      # The old one is aboard before the vehicle flies it.
      {_allowed, trial} = judge.([count(4) | old], Trial.new(policy()), snapshot(autopilot))
      messages |> judge.(trial, flying.(autopilot)) |> elem(0)
    end

    # From the new item in the south the vehicle would fly on to the old one in the north.
    new = [count(4), place(@west, 0), place(@south, 1), place(@east, 2), place(@east, 3)]
    assert [:allow, :allow, {:deny, :geofence, reason} | _] = sent.(new, :ardupilot)
    assert reason =~ ~s(enters the exclusion zone "tower")
    assert Enum.all?(sent.(new, :px4), &(&1 == :allow))
    same = [count(4), place(@west, 0), place(@west, 1), place({47.0151, 8.015}, 2), place(@east, 3)]
    assert Enum.all?(sent.(same, :ardupilot), &(&1 == :allow))

    assert [{:deny, :geofence, reason}] = decisions([count(4)], asked(flying.(:ardupilot)))
    assert reason =~ "the one aboard is not known; the gateway reads it now"
  end

  test "a mission that is entered: from where the vehicle is to the item, and on from there" do
    whole = [place(@west, 0), place(@west, 1), place(@north, 2), place(@east, 3), place({47.012, 8.025}, 4)]

    long =
      &struct!(
        %M.CommandLong{target_system: 1, target_component: 1, command: MavCmd.value(:"MAV_CMD_#{&1}")},
        &2
      )

    ways = [
      &%M.MissionSetCurrent{target_system: 1, target_component: 1, seq: &1},
      &long.("DO_SET_MISSION_CURRENT", param1: &1 / 1),
      &long.("DO_JUMP", param1: &1 / 1),
      &long.("MISSION_START", param1: &1 / 1)
    ]

    for autopilot <- [:ardupilot, :px4], way <- ways do
      # Armed at its first place.
      vehicle = snapshot(autopilot, @west, 1)
      assert {:deny, :geofence, reason} = last([count(5) | whole] ++ [way.(3)], vehicle)
      assert reason =~ ~s(enters the exclusion zone "tower")
      assert last([count(5) | whole] ++ [way.(2)], vehicle) == :allow
      assert {:deny, :geofence, reason} = last([way.(2)], vehicle)
      assert reason =~ "the mission aboard is not known; the gateway reads it now"
    end

    # Where it goes on: with its current item.
    on = fn seq, at -> {long.("DO_SET_MODE", param1: 1.0, param2: 3.0), snapshot(:ardupilot, at, seq)} end

    for {seq, at, allowed?} <- [
          {3, @west, false},
          {2, @west, true},
          {3, @north, true},
          {4, @south, true},
          {2, @south, false}
        ] do
      {auto, vehicle} = on.(seq, at)
      decision = last([count(5) | whole] ++ [auto], vehicle)
      assert decision == :allow == allowed?, inspect({seq, at, decision})
    end

    tagged = [
      place(@west, 0),
      place(@west, 1),
      place(@north, 2),
      place(@east, 3, command: 600, frame: 2, param1: 7.0),
      place(@east, 4)
    ]

    by_tag = long.("DO_JUMP_TAG", param1: 7.0)
    assert {:deny, :geofence, _} = last([count(5) | tagged] ++ [by_tag], snapshot(:ardupilot))
    assert last([count(5) | tagged] ++ [by_tag], snapshot(:ardupilot, @north)) == :allow

    landing = [
      place(@west, 0),
      place(@west, 1),
      place({0, 0}, 2, command: 189, frame: 2),
      place(@north, 3),
      place(@east, 4)
    ]

    land = long.("DO_LAND_START", [])
    assert last([count(5) | landing] ++ [land], snapshot(:ardupilot)) == :allow
    assert {:deny, :geofence, _} = last([count(5) | landing] ++ [land], snapshot(:ardupilot, @south))

    # What ends a flight stays free, and without a limit so does everything else.
    assert last([long.("NAV_RETURN_TO_LAUNCH", [])], snapshot(:ardupilot)) == :allow
    {:ok, free} = Policy.compile(%{})

    assert {%{decision: :allow}, _} =
             Trial.message(Trial.new(free), hd(ways).(3), asked(snapshot(:ardupilot)))
  end

  test "a fence is replaced by one that keeps as much, or with protection, or not at all" do
    corner = fn {lat, lon}, seq ->
      place({lat, lon}, seq, mission_type: 1, frame: 0, command: 5001, param1: 4.0, z: 0.0)
    end

    square = fn half ->
      for {{n, e}, seq} <- Enum.with_index([{-1, -1}, {-1, 1}, {1, 1}, {1, -1}]),
          do: corner.({47.01 + n * half, 8.015 + e * half}, seq)
    end

    dummy = [place(@west, 0, mission_type: 1, frame: 0, command: 5004, param1: 1.0)]
    fence = &[count(length(&1), mission_type: 1) | &1]

    # Nobody knows what is aboard.
    assert {:deny, :role, reason} = last([count(4, mission_type: 1)], snapshot(:px4))
    assert reason =~ "needs the permission protection" and reason =~ "the gateway reads it now"
    assert last(fence.(dummy), snapshot(:px4), :admin) == :allow

    read = fn items -> for message <- items, do: Item.read(message) end
    refute Kept.by?(read.(dummy), read.(square.(0.005)))
    assert Kept.by?(read.(square.(0.004)), read.(square.(0.005)))
  end

  # --- No sequence brings aboard what a file is refused

  @variants [@west, @north, @east, @south]

  defp step do
    :proper_types.frequency([
      {2, {:count, :proper_types.integer(1, 4)}},
      {8, {:item, :proper_types.integer(0, 4), :proper_types.integer(0, 4)}},
      {1, {:count_for_camera, :proper_types.integer(1, 4)}},
      {1, {:count, 60_000}},
      {1, {:partial, :proper_types.integer(0, 3), :proper_types.integer(0, 3)}},
      {1, :clear},
      {1, {:upload, :proper_types.list(:proper_types.integer(0, 4))}},
      {1, {:pause, :proper_types.integer(1, 20)}}
    ])
  end

  defp messages({:count, n}), do: [count(n)]
  defp messages({:count_for_camera, n}), do: [count(n, target_component: 100)]
  defp messages({:item, seq, 4}), do: [jump(rem(seq + 2, 4), seq)]
  defp messages({:item, seq, n}), do: [place(Enum.at(@variants, n), seq)]
  defp messages(:clear), do: [%M.MissionClearAll{target_system: 1, target_component: 1}]

  defp messages({:partial, a, b}),
    do: [
      %M.MissionWritePartialList{
        target_system: 1,
        target_component: 1,
        start_index: min(a, b),
        end_index: max(a, b)
      }
    ]

  defp messages({:upload, []}), do: []

  defp messages({:upload, variants}) do
    items = for {n, seq} <- Enum.with_index(Enum.take(variants, 4)), do: {:item, seq, n}
    [count(length(items)) | Enum.flat_map(items, &messages/1)]
  end

  # What a vehicle makes of a message: PX4 takes no notice of a MISSION_COUNT in the middle of an upload, ArduPilot
  # begins again.
  @idle %{count: nil, next: nil, last: nil, items: %{}}

  defp vehicle(state, _firmware, %{target_component: component}) when component != 1, do: state
  defp vehicle(%{next: next} = state, :px4, %M.MissionCount{}) when next != nil and next > 0, do: state
  defp vehicle(state, _firmware, %M.MissionCount{count: n}) when n > 700, do: state

  defp vehicle(state, _firmware, %M.MissionCount{count: n}),
    do: %{state | upload: %{@idle | count: n, next: 0, last: n - 1}, next: 0}

  defp vehicle(state, _firmware, %M.MissionClearAll{}), do: %{state | upload: @idle, next: nil, aboard: []}
  defp vehicle(state, :px4, %M.MissionWritePartialList{}), do: state

  # In place: each item counts at once.
  defp vehicle(state, :ardupilot, %M.MissionWritePartialList{start_index: first, end_index: last}) do
    if last < length(state.aboard),
      do: %{state | upload: %{@idle | count: :part, next: first, last: last}, next: first},
      else: state
  end

  defp vehicle(%{next: next} = state, _firmware, %M.MissionItemInt{seq: next} = item) when next != nil do
    upload = %{state.upload | items: Map.put(state.upload.items, next, Item.read(item))}

    aboard =
      if upload.count == :part, do: List.replace_at(state.aboard, next, Item.read(item)), else: state.aboard

    cond do
      next < upload.last -> %{state | upload: upload, next: next + 1, aboard: aboard}
      upload.count == :part -> %{state | upload: @idle, next: nil, aboard: aboard}
      true -> %{state | upload: @idle, next: nil, aboard: for(seq <- 0..upload.last, do: upload.items[seq])}
    end
  end

  defp vehicle(state, _firmware, _other), do: state

  test "no sequence of raw uploads brings aboard what the same plan as a file is refused" do
    policy = policy()

    for firmware <- [:ardupilot, :px4] do
      snapshot = snapshot(firmware)
      context = Context.seen(snapshot, nil, asked(snapshot).source, @start)
      kind = Map.take(snapshot, [:autopilot, :vehicle_type])

      property =
        :proper.forall(:proper_types.list(step()), fn steps ->
          begun = {Trial.new(policy), %{upload: @idle, next: nil, aboard: [], silence: 0}, 0}

          {_trial, state, _at} =
            Enum.reduce(steps, begun, fn
              {:pause, seconds}, {trial, state, at} ->
                # Given up by now, in one pause or in several.
                silence = state.silence + seconds
                state = if silence > 8, do: %{state | upload: @idle, next: nil}, else: state
                {trial, %{state | silence: silence}, at + seconds * @second}

              step, {trial, state, at} ->
                Enum.reduce(messages(step), {trial, state, at}, fn message, {trial, state, at} ->
                  {%{decision: decision}, trial} = Trial.message(trial, message, asked(snapshot, at))
                  heard = fn -> vehicle(%{state | silence: 0}, firmware, message) end
                  {trial, if(decision == :allow, do: heard.(), else: state), at}
                end)
            end)

          state.aboard == [] or Review.plan(policy, state.aboard, 0, kind, context) == :allow
        end)

      assert :proper.quickcheck(property, [:quiet, numtests: 1_000, max_size: 30]) == true,
             inspect({firmware, :proper.counterexample()}, limit: :infinity)
    end
  end
end
