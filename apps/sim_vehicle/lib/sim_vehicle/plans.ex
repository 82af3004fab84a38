defmodule SimVehicle.Plans do
  @moduledoc """
  Mission, fence and rally points on board, and the vehicle's side of the mission protocol (rules W1-W7).

  A plan is replaced only when an upload is complete (`Protocols.Mission.Upload`). Each item is stored as the firmware does it (`SimVehicle.Plans.Storage`). `style` is what the two firmwares do differently besides:

  - `:ardupilot`: requests with MISSION_REQUEST; item 0 of the mission is the home position; refuses an item out of sequence and a
    position beyond the globe
  - `:px4`: requests with MISSION_REQUEST_INT; requests the expected item again after one out of sequence; opaque ids
  """

  import Bitwise
  import MavCodec.Command

  alias MavCodec.Messages, as: M
  alias Protocols.Mission.{Reply, Upload}
  alias SimVehicle.Plans.Storage
  alias SimVehicle.Real32

  # Before the number of the parameter.
  @invalid_param Reply.result(:INVALID_PARAM1)

  @frames %{0 => [0, 2, 3, 5, 6, 10, 11], 1 => [0, 3, 5, 6], 2 => [0, 3, 5, 6, 10, 11]}
  @px4_frames %{0 => [0, 2, 3, 5, 6], 1 => [0, 2, 3, 5, 6], 2 => [0, 3, 5, 6]}

  @nav cmds(~w(
    NAV_WAYPOINT NAV_LOITER_UNLIM NAV_LOITER_TURNS NAV_LOITER_TIME NAV_RETURN_TO_LAUNCH NAV_LAND
    NAV_TAKEOFF NAV_LOITER_TO_ALT NAV_SPLINE_WAYPOINT NAV_VTOL_TAKEOFF NAV_VTOL_LAND NAV_DELAY
  )a)
  @conditions cmds(~w(CONDITION_DELAY CONDITION_DISTANCE CONDITION_YAW)a)
  @actions cmds(~w(
    DO_JUMP DO_CHANGE_SPEED DO_SET_HOME DO_SET_RELAY DO_REPEAT_RELAY DO_SET_SERVO DO_REPEAT_SERVO
    DO_LAND_START DO_SET_ROI_LOCATION DO_SET_ROI_NONE DO_SET_ROI DO_DIGICAM_CONTROL DO_MOUNT_CONTROL
    DO_SET_CAM_TRIGG_DIST DO_GRIPPER
  )a)
  @cameras cmds(~w(
    DO_GIMBAL_MANAGER_PITCHYAW IMAGE_START_CAPTURE IMAGE_STOP_CAPTURE VIDEO_START_CAPTURE
    VIDEO_STOP_CAPTURE DO_VTOL_TRANSITION
  )a)
  @commands %{
    0 => @nav ++ @conditions ++ @actions ++ @cameras,
    1 => cmds(~w(
      NAV_FENCE_RETURN_POINT NAV_FENCE_POLYGON_VERTEX_INCLUSION NAV_FENCE_POLYGON_VERTEX_EXCLUSION
      NAV_FENCE_CIRCLE_INCLUSION NAV_FENCE_CIRCLE_EXCLUSION NAV_FENCE_HOME_CIRCLE_INCLUSION
    )a),
    2 => [cmd(:NAV_RALLY_POINT)]
  }
  # Their x and y are not degrees in MISSION_ITEM, either (AP_Mission.cpp: `convert_MISSION_ITEM_to_MISSION_ITEM_INT`).
  @plain_xy cmds(~w(DO_DIGICAM_CONFIGURE DO_DIGICAM_CONTROL DO_GIMBAL_MANAGER_PITCHYAW NAV_ATTITUDE_TIME)a)

  @rules %{
    ardupilot: %{request: M.MissionRequest, again_us: 1_000_000, patience_us: 8_000_000, out_of_turn: :refuse},
    px4: %{again_us: 250_000, patience_us: 5_000_000, out_of_turn: :ask_unless_repeated}
  }
  @capacity %{ardupilot: %{0 => 724, 1 => 70, 2 => 70}, px4: %{0 => 2000, 1 => 128, 2 => 64}}

  defstruct style: :ardupilot,
            rules: @rules.ardupilot,
            items: %{0 => [], 1 => [], 2 => []},
            opaque: %{0 => 0, 1 => 0, 2 => 0},
            upload: nil

  @typedoc "One item: the fields of MISSION_ITEM_INT."
  @type item :: %{
          seq: non_neg_integer,
          frame: integer,
          command: integer,
          current: integer,
          autocontinue: integer,
          params: {term, term, term, term},
          x: integer,
          y: integer,
          z: float
        }
  @type t :: %__MODULE__{}

  @typedoc "Messages to send, and `{:stored, type}` or `{:cleared, type}` when a plan was replaced."
  @type reply :: struct | {:stored, 0..2} | {:cleared, 0..2} | {:text, 0..7, String.t()}

  @doc "No plans. `speed`: of the vehicle's time against that in which the ground station answers."
  @spec new(:ardupilot | :px4, speed :: number) :: t
  def new(style, speed \\ 1.0) do
    rules = Map.update!(@rules[style], :patience_us, &(&1 * max(speed, 1.0)))
    %__MODULE__{style: style, rules: rules}
  end

  @doc "The items of a plan by `mission_type`: 0 mission, 1 fence, 2 rally."
  @spec items(t, 0..2) :: [item]
  def items(plans, type), do: Map.fetch!(plans.items, type)

  @doc "Replaces a plan without the protocol (a plan that was on board from the start)."
  @spec put(t, 0..2, [item]) :: t
  def put(plans, type, items) do
    items = Enum.map(items, &Storage.kept(&1, plans.style, type))
    %{plans | items: Map.put(plans.items, type, items)} |> fresh_opaque(type)
  end

  @doc """
  Handles a message of the mission protocol that is addressed to this vehicle. `home` is the item that ArduPilot shows
  as number 0, `now` the vehicle's time in microseconds. nil: not a message of this protocol.
  """
  @spec handle(t, struct, {integer, integer}, map | nil, integer) :: {t, [reply]} | nil
  def handle(plans, message, from, home, now)

  def handle(plans, %M.MissionRequestList{} = m, from, home, _now) do
    case valid_type(plans, m.mission_type) do
      true -> {plans, [count_message(plans, m.mission_type, from, home)]}
      false -> {plans, [ack(plans, from, :UNSUPPORTED, m.mission_type)]}
    end
  end

  def handle(plans, %M.MissionRequestInt{} = m, from, home, _now), do: read(plans, m, from, home, :int)
  def handle(plans, %M.MissionRequest{} = m, from, home, _now), do: read(plans, m, from, home, :float)
  def handle(plans, %M.MissionCount{} = m, from, _home, now), do: begin(plans, m, from, now)

  def handle(plans, %M.MissionItemInt{} = m, from, _home, now), do: take(plans, m, from, now)

  def handle(plans, %M.MissionItem{} = m, from, _home, now) do
    scale = if degrees?(m), do: 1.0e7, else: 1.0
    fields = m |> Map.from_struct() |> Map.merge(%{x: coordinate(m.x, scale), y: coordinate(m.y, scale)})
    take(plans, struct!(M.MissionItemInt, fields), from, now)
  end

  def handle(plans, %M.MissionClearAll{} = m, from, _home, _now) do
    types = if m.mission_type == 255, do: [0, 1, 2], else: [m.mission_type]

    cond do
      not Enum.all?(types, &valid_type(plans, &1)) ->
        {plans, [ack(plans, from, :UNSUPPORTED, m.mission_type)]}

      plans.upload != nil ->
        {plans, [ack(plans, from, :DENIED, m.mission_type)]}

      true ->
        cleared = Enum.reduce(types, plans, &put(&2, &1, []))
        {cleared, [ack(cleared, from, :ACCEPTED, m.mission_type) | Enum.map(types, &{:cleared, &1})]}
    end
  end

  def handle(plans, %M.MissionAck{type: type}, from, _home, now) when type != 0,
    do: upload(plans, {:cancelled, from}, now)

  def handle(plans, %M.MissionAck{}, _from, _home, _now), do: {plans, []}
  def handle(_plans, _message, _from, _home, _now), do: nil

  @doc "Requests a missing item again, and gives up after a while (W1)."
  @spec tick(t, integer) :: {t, [reply]}
  def tick(plans, now), do: upload(plans, :tick, now)

  # --- upload ---

  defp begin(plans, m, from, now) do
    type = m.mission_type

    cond do
      not valid_type(plans, type) ->
        {plans, [ack(plans, from, :UNSUPPORTED, type)]}

      m.count > @capacity[plans.style][type] ->
        {plans, [ack(plans, from, :NO_SPACE, type)]}

      plans.upload != nil and plans.upload.from != from ->
        {plans, [ack(plans, from, :DENIED, type)]}

      m.count == 0 ->
        cleared = put(plans, type, [])
        {cleared, [ack(cleared, from, :ACCEPTED, type), {:cleared, type}]}

      true ->
        upload(plans, {:count, m, from}, now)
    end
  end

  defp take(plans, m, from, now) do
    type = m.mission_type
    refusal = if Upload.expects?(plans.upload, m, from), do: refusal(plans, type, item(m))

    if refusal,
      do: {%{plans | upload: nil}, [ack(plans, from, refusal, type) | refusal_text(plans.style)]},
      else: upload(plans, {:item, m, from}, now)
  end

  defp refusal_text(:px4), do: [{:text, 2, "IGN MISSION_ITEM: Invalid item\t"}]
  defp refusal_text(:ardupilot), do: []

  defp upload(plans, event, now) do
    {upload, actions} = Upload.handle(plans.upload, event, plans.rules, now)

    Enum.reduce(actions, {%{plans | upload: upload}, []}, fn action, {plans, replies} ->
      {plans, more} = act(plans, action, event)
      {plans, replies ++ more}
    end)
  end

  defp act(plans, {:send, message}, _event), do: {plans, [message]}

  defp act(%{upload: %{type: type, from: from}} = plans, {:store, items}, _event) do
    stored = %{put(plans, type, Enum.map(items, &item/1)) | upload: nil}
    {stored, [ack(stored, from, :ACCEPTED, type), {:stored, type}]}
  end

  defp act(%{style: :ardupilot} = plans, :stray, {:item, m, from}),
    do: {plans, [ack(plans, from, :ERROR, m.mission_type)]}

  defp act(plans, :stray, _event), do: {plans, []}

  defp refusal(plans, type, item) do
    frames = if plans.style == :px4, do: @px4_frames, else: @frames

    cond do
      item.command not in @commands[type] -> :UNSUPPORTED
      item.frame not in frames[type] -> :UNSUPPORTED_FRAME
      (unset = unset_param(plans, type, item)) != nil -> @invalid_param + unset
      plans.style == :ardupilot and place?(type, item) and beyond_globe?(item) -> :INVALID_PARAM5_X
      true -> nil
    end
  end

  # AP_Mission.cpp, `sanity_check_params`: which parameters may be NaN.
  @unset %{
    cmd(:NAV_WAYPOINT) => [3],
    cmd(:NAV_LAND) => [3],
    cmd(:NAV_TAKEOFF) => [3],
    cmd(:NAV_VTOL_TAKEOFF) => [3],
    cmd(:NAV_VTOL_LAND) => [2, 3]
  }

  defp unset_param(%{style: :ardupilot}, 0, item) do
    params = item.params |> Tuple.to_list() |> Enum.with_index()

    Enum.find_value(params, fn {value, index} ->
      if Real32.number(value) == nil and index not in Map.get(@unset, item.command, []), do: index
    end)
  end

  defp unset_param(_plans, _type, _item), do: nil

  defp place?(0, item), do: item.frame != 2 and Storage.place?(item.command)
  defp place?(_fence_or_rally, _item), do: true

  defp beyond_globe?(item), do: abs(item.x) > 900_000_000 or abs(item.y) > 1_800_000_000

  # --- download ---

  defp count_message(plans, type, from, home),
    do: Reply.count(type, length(read_back(plans, type, home)), from, opaque(plans, type))

  defp read(plans, m, from, home, coding) do
    shown = if valid_type(plans, m.mission_type), do: read_back(plans, m.mission_type, home), else: []

    case Enum.at(shown, m.seq) do
      nil when plans.style == :ardupilot -> {plans, [ack(plans, from, :INVALID_SEQUENCE, m.mission_type)]}
      nil -> {plans, []}
      item -> {plans, [item_message(item, m.seq, m.mission_type, from, coding)]}
    end
  end

  # ArduPilot keeps home as item 0 once a mission was loaded, whatever was uploaded there.
  defp read_back(%{style: :ardupilot} = plans, 0, home) when home != nil do
    case items(plans, 0) do
      [] -> []
      [_uploaded | rest] -> [home | rest]
    end
  end

  defp read_back(plans, type, _home), do: items(plans, type)

  defp item_message(item, seq, type, {system, component}, :int) do
    {p1, p2, p3, p4} = item.params

    %M.MissionItemInt{
      target_system: system,
      target_component: component,
      seq: seq,
      frame: item.frame,
      command: item.command,
      current: item.current,
      autocontinue: item.autocontinue,
      param1: p1,
      param2: p2,
      param3: p3,
      param4: p4,
      x: item.x,
      y: item.y,
      z: item.z,
      mission_type: type
    }
  end

  defp item_message(item, seq, type, from, :float) do
    int = item_message(item, seq, type, from, :int)
    scale = if degrees?(item), do: 1.0e7, else: 1.0
    fields = int |> Map.from_struct() |> Map.merge(%{x: item.x / scale, y: item.y / scale})
    struct!(M.MissionItem, fields)
  end

  defp item(m) do
    %{
      seq: m.seq,
      frame: m.frame,
      command: m.command,
      current: 0,
      autocontinue: m.autocontinue,
      params: {m.param1, m.param2, m.param3, m.param4},
      x: m.x,
      y: m.y,
      z: Real32.number(m.z) || 0.0
    }
  end

  defp degrees?(item), do: item.command not in @plain_xy and item.frame != 2

  defp coordinate(value, scale) when is_number(value) and abs(value) < 200, do: round(value * scale)
  defp coordinate(_value, _scale), do: 2_147_483_647

  defp ack(plans, from, result, type),
    do: Reply.ack(type, result, from, if(result == :ACCEPTED, do: opaque(plans, type), else: 0))

  defp opaque(plans, type), do: if(plans.style == :px4, do: Map.get(plans.opaque, type, 0), else: 0)

  # PX4 identifies a plan by a checksum of it; the value has no meaning, only that it changes (W7).
  defp fresh_opaque(plans, type) do
    items = items(plans, type)
    id = if items == [], do: 0, else: :erlang.crc32(:erlang.term_to_binary(items)) ||| 1
    %{plans | opaque: Map.put(plans.opaque, type, id)}
  end

  defp valid_type(plans, type), do: is_map_key(plans.items, type)
end
