defmodule Msp.Mission do
  @moduledoc """
  iNav's waypoints as items of a MAVLink mission, and back.

  | waypoint | item |
  |---|---|
  | WAYPOINT | NAV_WAYPOINT |
  | HOLD_TIME | NAV_LOITER_TIME, or NAV_WAYPOINT with a time to hold |
  | RTH | NAV_RETURN_TO_LAUNCH; parameter 1: 0 lands, 1 stays above home |
  | LAND | NAV_LAND; parameter 3: height of the ground in m |
  | JUMP | DO_JUMP |
  | SET_POI | DO_SET_ROI_LOCATION |
  | SET_HEAD | CONDITION_YAW, absolute, or DO_SET_ROI_NONE for none |
  | speed of a waypoint | DO_CHANGE_SPEED directly before it; it stays until the next one, -2 is the vehicle's own |
  | user actions of a waypoint | USER_1 directly after it, with 0 or 1 in each of its first four parameters |
  | waypoint at home (flag 0x48) | the item in the frame LOCAL_ENU, at 0, 0 |

  Speeds and user actions are items of their own, so numbers of items are not those of waypoints. What iNav does not keep of an
  item is in `Aerie.Vehicle.Firmware.Inav.StoredItem`. Each mission has one form of items: what would come back as others is an error.
  """

  alias MavCodec.Enums.{MavCmd, MavFrame}
  alias MavCodec.Messages.MissionItemInt
  alias Msp.Mission.Items

  @waypoint 1
  @hold 3
  @rth 4
  @poi 5
  @jump 6
  @head 7
  @land 8
  @actions %{
    @waypoint => "WAYPOINT",
    @hold => "HOLD_TIME",
    @rth => "RTH",
    @poi => "SET_POI",
    @jump => "JUMP",
    @head => "SET_HEAD",
    @land => "LAND"
  }
  # Those that the vehicle flies to.
  @places [@waypoint, @hold, @land]
  @last 0xA5
  @home 0x48
  @msl 1
  @most 120

  @command Map.new(
             ~w(NAV_WAYPOINT NAV_LOITER_TIME NAV_RETURN_TO_LAUNCH NAV_LAND DO_JUMP DO_SET_ROI_LOCATION DO_SET_ROI_NONE
                CONDITION_YAW DO_CHANGE_SPEED USER_1)a,
             &{&1, MavCmd.value(:"MAV_CMD_#{&1}")}
           )
  @frame_msl MavFrame.value(:MAV_FRAME_GLOBAL)
  @frame_home MavFrame.value(:MAV_FRAME_GLOBAL_RELATIVE_ALT)
  @frame_none MavFrame.value(:MAV_FRAME_MISSION)
  @frame_local MavFrame.value(:MAV_FRAME_LOCAL_ENU)

  @typedoc "The fields of WP and SET_WP: 1e-7 degrees, cm."
  @type waypoint :: %{
          number: 1..255,
          action: byte,
          lat: integer,
          lon: integer,
          altitude: integer,
          p1: integer,
          p2: integer,
          p3: integer,
          flag: byte
        }

  @doc "How many waypoints iNav has room for; boards with little memory have fewer, which WP_GETINFO says."
  @spec most() :: pos_integer
  def most, do: @most

  @doc "The actions that are known, by number."
  @spec actions() :: %{byte => String.t()}
  def actions, do: @actions

  @doc "The waypoints of a list of items; the last one has the flag that ends a mission."
  @spec waypoints([MissionItemInt.t()]) ::
          {:ok, [waypoint]} | {:error, {:unsupported | :frame | :invalid, String.t()}}
  defdelegate waypoints(items), to: Items

  @doc "Whether two waypoints are the same for a vehicle: it counts a jump's turns in a field, and the one at home has no place of its own."
  @spec same?(waypoint, waypoint) :: boolean
  def same?(%{action: @jump} = a, b), do: %{a | p3: 0} == %{b | p3: 0}
  def same?(%{flag: @home} = a, b), do: %{a | lat: 0, lon: 0} == %{b | lat: 0, lon: 0}
  def same?(a, b), do: a == b

  @doc "The items of a mission, numbered from 0. What MAVLink cannot say is an error."
  @spec items([waypoint]) :: {:ok, [MissionItemInt.t()]} | {:error, String.t()}
  def items(waypoints) do
    with :ok <- known(waypoints) do
      firsts = firsts(waypoints)

      {all, _speed} =
        Enum.flat_map_reduce(waypoints, 0, fn waypoint, speed ->
          {before, speed} = change_speed(waypoint, speed)
          {before ++ [item(waypoint, firsts)] ++ user(waypoint), speed}
        end)

      {:ok,
       for({item, seq} <- Enum.with_index(all), do: %{item | seq: seq, current: if(seq == 0, do: 1, else: 0)})}
    end
  end

  @doc "The number of the item that belongs to a waypoint by its number: its own, not that of its speed."
  @spec seq([waypoint], number :: pos_integer) :: non_neg_integer
  def seq(waypoints, number) when is_integer(number) do
    with seq when is_integer(seq) <- firsts(waypoints)[number],
         {waypoint, speed} <- reached(waypoints, number) do
      seq + length(elem(change_speed(waypoint, speed), 0))
    else
      _unknown -> max(number - 1, 0)
    end
  end

  defp reached(waypoints, number) do
    {before, rest} = Enum.split_while(waypoints, &(&1.number != number))
    {hd(rest), Enum.reduce(before, 0, &elem(change_speed(&1, &2), 1))}
  end

  # The first item of each waypoint: a jump goes there.
  defp firsts(waypoints) do
    {firsts, _seq_and_speed} =
      Enum.map_reduce(waypoints, {0, 0}, fn waypoint, {seq, speed} ->
        {before, speed} = change_speed(waypoint, speed)
        {{waypoint.number, seq}, {seq + length(before) + 1 + length(user(waypoint)), speed}}
      end)

    Map.new(firsts)
  end

  defp known(waypoints) do
    {last, others} = List.pop_at(waypoints, -1)

    cond do
      last == nil ->
        :ok

      Enum.any?(others, &(&1.flag == @last)) ->
        {:error, "several missions are aboard, which MAVLink cannot tell apart"}

      odd = Enum.find(waypoints, &(not is_map_key(@actions, &1.action))) ->
        {:error, "waypoint #{odd.number} has the action #{odd.action}, which is not known"}

      odd = Enum.find(waypoints, &(&1.action == @jump and &1.p1 not in 1..length(waypoints))) ->
        {:error,
         "waypoint #{odd.number} jumps to waypoint #{odd.p1}, which is not there: iNav does not arm with that"}

      odd = Enum.find(waypoints, &(&1.flag == @home and Bitwise.band(&1.p3, @msl) != 0)) ->
        {:error, "waypoint #{odd.number} is at home with a height above sea level, which MAVLink cannot say"}

      true ->
        :ok
    end
  end

  defp change_speed(%{action: action} = waypoint, speed) when action in @places do
    case speed(waypoint) do
      ^speed -> {[], speed}
      0 -> {[plain(:DO_CHANGE_SPEED, {1, -2})], 0}
      cm_s -> {[plain(:DO_CHANGE_SPEED, {1, cm_s / 100})], cm_s}
    end
  end

  defp change_speed(_waypoint, speed), do: {[], speed}

  defp speed(%{action: @hold, p2: cm_s}), do: max(cm_s, 0)
  defp speed(%{p1: cm_s}), do: max(cm_s, 0)

  defp user(%{action: action, p3: p3}) when action in @places do
    case for(bit <- 1..4, do: Bitwise.band(Bitwise.bsr(p3, bit), 1)) do
      [0, 0, 0, 0] -> []
      [a, b, c, d] -> [plain(:USER_1, {a, b, c, d})]
    end
  end

  defp user(_waypoint), do: []

  defp item(%{action: @waypoint} = w, _firsts), do: place(:NAV_WAYPOINT, {}, w)
  defp item(%{action: @hold} = w, _firsts), do: place(:NAV_LOITER_TIME, {w.p1}, w)
  defp item(%{action: @land} = w, _firsts), do: place(:NAV_LAND, {0, 0, w.p2}, w)
  defp item(%{action: @poi} = w, _firsts), do: place(:DO_SET_ROI_LOCATION, {}, w)
  defp item(%{action: @rth, p1: 0}, _firsts), do: plain(:NAV_RETURN_TO_LAUNCH, {1})
  defp item(%{action: @rth}, _firsts), do: plain(:NAV_RETURN_TO_LAUNCH, {0})
  defp item(%{action: @head, p1: -1}, _firsts), do: plain(:DO_SET_ROI_NONE, {})
  defp item(%{action: @head, p1: degrees}, _firsts), do: plain(:CONDITION_YAW, {degrees})

  defp item(%{action: @jump, p1: target, p2: repeat}, firsts),
    do: plain(:DO_JUMP, {firsts[target], repeat})

  defp place(name, params, %{flag: @home} = w),
    do: %{message(name, params, @frame_local) | z: w.altitude / 100}

  defp place(name, params, w) do
    frame = if Bitwise.band(w.p3, @msl) == 0, do: @frame_home, else: @frame_msl
    %{message(name, params, frame) | x: w.lat, y: w.lon, z: w.altitude / 100}
  end

  defp plain(name, params), do: message(name, params, @frame_none)

  defp message(name, params, frame) do
    [p1, p2, p3, p4] =
      params |> Tuple.to_list() |> Kernel.++([0, 0, 0, 0]) |> Enum.take(4) |> Enum.map(&(&1 / 1))

    %MissionItemInt{
      command: @command[name],
      frame: frame,
      autocontinue: 1,
      param1: p1,
      param2: p2,
      param3: p3,
      param4: p4
    }
  end
end
