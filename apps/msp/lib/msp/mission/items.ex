defmodule Msp.Mission.Items do
  @moduledoc false
  # `Msp.Mission.waypoints/1`.

  alias MavCodec.Enums.{MavCmd, MavFrame}

  @commands Map.new(
              ~w(NAV_WAYPOINT NAV_LOITER_TIME NAV_RETURN_TO_LAUNCH NAV_LAND NAV_TAKEOFF DO_JUMP DO_SET_ROI DO_SET_ROI_LOCATION
                 DO_SET_ROI_NONE CONDITION_YAW DO_CHANGE_SPEED USER_1)a,
              &{MavCmd.value(:"MAV_CMD_#{&1}"), &1}
            )
  @frames %{
    MavFrame.value(:MAV_FRAME_GLOBAL) => :msl,
    MavFrame.value(:MAV_FRAME_GLOBAL_INT) => :msl,
    MavFrame.value(:MAV_FRAME_GLOBAL_RELATIVE_ALT) => :home,
    MavFrame.value(:MAV_FRAME_GLOBAL_RELATIVE_ALT_INT) => :home,
    MavFrame.value(:MAV_FRAME_LOCAL_ENU) => :at_home
  }
  @waypoint 1
  @hold 3
  @rth 4
  @poi 5
  @jump 6
  @head 7
  @land 8
  @places [@waypoint, @hold, @land]
  @last 0xA5
  @at_home 0x48
  @i16 -0x8000..0x7FFF
  @i32 -0x80000000..0x7FFFFFFF
  # MAV_ROI_LOCATION
  @roi_location 3
  @speeds "a speed is in m/s above the ground, from 0.01 to 327, or -2 for the vehicle's own"

  # `waypoints`: newest first; `speed`: the one that holds, in cm/s; `change`: the number of the item that sets the next waypoint's;
  # `targets`: by an item's number the waypoint that a jump to it goes to.
  defstruct waypoints: [], speed: 0, change: nil, targets: %{}

  def waypoints(items) do
    count = length(items)

    items
    |> Enum.with_index()
    |> Enum.reduce_while({:ok, %__MODULE__{}}, fn {item, seq}, {:ok, state} ->
      case checked(state, Map.get(@commands, item.command), item, seq, count) do
        {:ok, state} -> {:cont, {:ok, state}}
        {:error, kind, why} -> {:halt, {:error, {kind, "item #{seq + 1}: #{why}"}}}
      end
    end)
    |> finished(count)
  end

  defp finished({:error, _why} = error, _count), do: error

  defp finished({:ok, %{change: seq}}, _count) when seq != nil,
    do: {:error, {:invalid, "item #{seq + 1}: no waypoint follows the change of speed"}}

  defp finished({:ok, state}, _count) do
    number = length(state.waypoints)
    waypoints = state.waypoints |> Enum.reverse() |> Enum.map(&last(&1, number))

    with :ok <- room(number), {:ok, waypoints} <- jumps(waypoints, state.targets), do: ends(waypoints)
  end

  defp last(%{number: number, flag: 0} = waypoint, number), do: %{waypoint | flag: @last}
  defp last(waypoint, _number), do: waypoint

  defp ends(waypoints) do
    case List.last(waypoints) do
      %{flag: @at_home} ->
        {:error, {:invalid, "the last waypoint of iNav cannot be the one at home: use a return"}}

      _other ->
        {:ok, waypoints}
    end
  end

  defp room(number) do
    if number <= Msp.Mission.most(),
      do: :ok,
      else: {:error, {:invalid, "it has #{number} waypoints; iNav has room for #{Msp.Mission.most()}"}}
  end

  # A vehicle with another jump cannot be armed.
  defp jumps(waypoints, targets) do
    places = for %{action: action, number: number} <- waypoints, action in @places, do: number

    Enum.reduce_while(waypoints, {:ok, []}, fn
      %{action: @jump, p1: seq} = waypoint, {:ok, done} ->
        number = targets[seq]

        cond do
          number == :speed_before ->
            {:halt, jump(waypoint, "jumps past the change of speed before its target: let it jump to that")}

          number not in places ->
            {:halt, jump(waypoint, "jumps to what is not a waypoint, a hold or a landing")}

          abs(number - waypoint.number) < 2 ->
            {:halt, jump(waypoint, "jumps to a waypoint beside it")}

          true ->
            {:cont, {:ok, [%{waypoint | p1: number} | done]}}
        end

      waypoint, {:ok, done} ->
        {:cont, {:ok, [waypoint | done]}}
    end)
    |> then(fn
      {:ok, done} -> {:ok, Enum.reverse(done)}
      error -> error
    end)
  end

  defp jump(%{number: number}, why),
    do: {:error, {:invalid, "waypoint #{number} #{why}; iNav does not arm with that"}}

  defp checked(_state, _name, %{autocontinue: 0}, seq, count) when seq + 1 < count,
    do: {:error, :unsupported, "iNav does not wait after an item (autocontinue 0)"}

  defp checked(state, name, item, seq, _count) do
    cond do
      state.change && name not in [:NAV_WAYPOINT, :NAV_LOITER_TIME, :NAV_LAND] ->
        {:error, :invalid, "a change of speed comes directly before the waypoint that it is for"}

      name in [nil, :NAV_TAKEOFF] ->
        {:error, :unsupported, refusal(name, item.command)}

      true ->
        item(state, name, item, seq)
    end
  end

  defp refusal(:NAV_TAKEOFF, _command), do: "iNav takes off by hand or by NAV LAUNCH: leave the take-off out"

  defp refusal(nil, command) do
    name = MavCmd.name(command)

    "iNav has nothing for #{if(name, do: name |> to_string() |> String.replace_prefix("MAV_CMD_", ""), else: "command #{command}")}"
  end

  defp item(state, :NAV_WAYPOINT, item, seq) do
    case whole(item.param1, 1) do
      {:ok, 0} -> place(state, @waypoint, item, seq, fn speed -> %{p1: speed} end)
      {:ok, _held} -> item(state, :NAV_LOITER_TIME, item, seq)
      error -> error
    end
  end

  defp item(state, :NAV_LOITER_TIME, item, seq) do
    with {:ok, seconds} <- whole(item.param1, 1) do
      if seconds >= 0,
        do: place(state, @hold, item, seq, fn speed -> %{p1: seconds, p2: speed} end),
        else: {:error, :invalid, "a time to hold is not negative"}
    end
  end

  defp item(state, :NAV_LAND, item, seq) do
    with {:ok, ground} <- whole(item.param3, 1),
         do: place(state, @land, item, seq, fn speed -> %{p1: speed, p2: ground} end)
  end

  defp item(state, :NAV_RETURN_TO_LAUNCH, item, seq) do
    case whole(item.param1, 1) do
      {:ok, stays} when stays in [0, 1] -> add(state, seq, %{action: @rth, p1: 1 - stays})
      _other -> {:error, :invalid, "parameter 1 of a return is 0 (it lands) or 1 (it stays above home)"}
    end
  end

  defp item(state, :DO_SET_ROI, item, seq) do
    if number(item.param1) == @roi_location,
      do: item(state, :DO_SET_ROI_LOCATION, item, seq),
      else: {:error, :unsupported, "iNav looks at places only (DO_SET_ROI_LOCATION)"}
  end

  defp item(state, :DO_SET_ROI_LOCATION, item, seq) do
    with {:ok, %{flag: 0} = at} <- at(item) do
      add(state, seq, Map.put(at, :action, @poi))
    else
      {:ok, _at_home} -> {:error, :frame, "iNav looks at a place with coordinates"}
      error -> error
    end
  end

  defp item(state, :DO_SET_ROI_NONE, _item, seq), do: add(state, seq, %{action: @head, p1: -1})

  defp item(state, :CONDITION_YAW, item, seq) do
    case {whole(item.param1, 1), number(item.param4)} do
      {{:ok, degrees}, relative} when degrees in 0..360 and relative == 0 ->
        add(state, seq, %{action: @head, p1: rem(degrees, 360)})

      _other ->
        {:error, :invalid, "a heading goes from 0 to 360 degrees and is absolute (parameter 4 is 0)"}
    end
  end

  defp item(state, :DO_JUMP, item, seq) do
    case {whole(item.param1, 1), whole(item.param2, 1)} do
      {{:ok, target}, {:ok, repeat}} when target >= 0 and repeat >= -1 ->
        add(state, seq, %{action: @jump, p1: target, p2: repeat})

      _other ->
        {:error, :invalid, "a jump has the number of an item, and how often, or -1 for ever"}
    end
  end

  defp item(state, :DO_CHANGE_SPEED, item, seq) do
    own = number(item.param2) == -2
    speed = if own, do: {:ok, 0}, else: whole(item.param2, 100)

    case {speed, number(item.param1) == 0 or number(item.param1) == 1} do
      # A waypoint of iNav with speed 0 is flown at the vehicle's own, which is not what a sender of 0 means.
      {{:ok, cm_s}, true} when cm_s < 0 or (cm_s == 0 and not own) ->
        {:error, :invalid, @speeds}

      {{:ok, cm_s}, true} when cm_s == state.speed ->
        {:error, :invalid, "the speed is set already"}

      {{:ok, cm_s}, true} ->
        {:ok, %{state | speed: cm_s, change: seq}}

      _other ->
        {:error, :invalid, @speeds}
    end
  end

  defp item(%{waypoints: [%{action: action, p3: p3} = before | rest]} = state, :USER_1, item, _seq)
       when action in @places and p3 < 2 do
    bits =
      for value <- [item.param1, item.param2, item.param3, item.param4],
          {:ok, bit} <- [whole(value, 1)],
          do: bit

    if Enum.sort(bits) in [[0, 0, 0, 1], [0, 0, 1, 1], [0, 1, 1, 1], [1, 1, 1, 1]] do
      users =
        for {1, bit} <- Enum.with_index(bits, 1),
            reduce: 0,
            do: (sum -> sum + Bitwise.bsl(1, bit))

      {:ok, %{state | waypoints: [%{before | p3: p3 + users} | rest]}}
    else
      {:error, :invalid, "user actions are 0 or 1 in the first four parameters, and one at least is 1"}
    end
  end

  defp item(_state, :USER_1, _item, _seq),
    do: {:error, :invalid, "user actions come directly after the waypoint that they are for"}

  defp place(state, action, item, seq, fields) do
    with {:ok, at} <- at(item),
         do: add(state, seq, at |> Map.put(:action, action) |> Map.merge(fields.(state.speed)))
  end

  defp add(state, seq, fields) do
    number = length(state.waypoints) + 1
    empty = %{number: number, lat: 0, lon: 0, altitude: 0, p1: 0, p2: 0, p3: 0, flag: 0}
    waypoint = Map.merge(empty, fields)

    cond do
      number > 255 ->
        {:error, :invalid, "iNav has room for #{Msp.Mission.most()} waypoints"}

      Enum.any?([:p1, :p2, :p3], &(waypoint[&1] not in @i16)) ->
        {:error, :invalid, "a value is too large for iNav"}

      true ->
        targets =
          if state.change,
            do: %{state.change => number, seq => :speed_before},
            else: %{seq => number}

        {:ok,
         %{
           state
           | waypoints: [waypoint | state.waypoints],
             change: nil,
             targets: Map.merge(state.targets, targets)
         }}
    end
  end

  defp at(%{z: unset}) when not is_number(unset), do: {:error, :invalid, "it has no height"}

  defp at(%{frame: frame, x: x, y: y} = item) do
    with {:ok, cm} <- whole(item.z, 100) do
      case Map.get(@frames, frame) do
        _frame when cm not in @i32 ->
          {:error, :invalid, "its height is too large"}

        :at_home when x == 0 and y == 0 ->
          {:ok, %{altitude: cm, flag: @at_home}}

        # That is where a place is missing.
        height when height in [:home, :msl] and x == 0 and y == 0 ->
          {:error, :invalid, "it has no place"}

        height
        when height in [:home, :msl] and x in -900_000_000..900_000_000 and y in -1_800_000_000..1_800_000_000 ->
          {:ok, %{lat: x, lon: y, altitude: cm, p3: if(height == :msl, do: 1, else: 0), flag: 0}}

        height when height in [:home, :msl] ->
          {:error, :invalid, "it has no place on Earth"}

        _other ->
          {:error, :frame, "iNav has heights above home and above sea level, not frame #{frame}"}
      end
    end
  end

  defp whole(value, factor) do
    number = number(value) * factor

    if abs(number) < 1.0e12,
      do: {:ok, round(number)},
      else: {:error, :invalid, "a value is too large for iNav"}
  end

  # What is unset is 0.
  defp number(value) when is_number(value), do: value
  defp number(_unset), do: 0
end
