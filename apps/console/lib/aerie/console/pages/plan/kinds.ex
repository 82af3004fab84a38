defmodule Aerie.Console.Pages.Plan.Kinds do
  @moduledoc """
  The kinds of mission items that the page offers: their names, and what their parameters mean. A plan may have others; they are shown
  by number and kept as they are.
  """

  alias Protocols.Mission.Item
  alias MavCodec.Enums.MavCmd

  # {MAV_CMD, name, has a place, [{parameter 1..4, label, unit, default}]}
  @kinds [
    {:MAV_CMD_NAV_WAYPOINT, "Waypoint", true, [{1, "Hold", "s", 0.0}, {2, "Acceptance radius", "m", 0.0}]},
    {:MAV_CMD_NAV_TAKEOFF, "Takeoff", true, [{1, "Pitch", "°", 0.0}]},
    {:MAV_CMD_NAV_LAND, "Land", true, []},
    {:MAV_CMD_NAV_RETURN_TO_LAUNCH, "Return to launch", false, []},
    {:MAV_CMD_NAV_LOITER_UNLIM, "Loiter", true, [{3, "Radius", "m", 0.0}]},
    {:MAV_CMD_NAV_LOITER_TIME, "Loiter for a time", true, [{1, "Time", "s", 30.0}, {3, "Radius", "m", 0.0}]},
    {:MAV_CMD_NAV_LOITER_TURNS, "Loiter turns", true, [{1, "Turns", nil, 1.0}, {3, "Radius", "m", 0.0}]},
    {:MAV_CMD_NAV_SPLINE_WAYPOINT, "Spline waypoint", true, [{1, "Hold", "s", 0.0}]},
    {:MAV_CMD_NAV_VTOL_TAKEOFF, "VTOL takeoff", true, []},
    {:MAV_CMD_NAV_VTOL_LAND, "VTOL land", true, []},
    {:MAV_CMD_NAV_DELAY, "Delay", false, [{1, "Time", "s", 10.0}]},
    {:MAV_CMD_CONDITION_DELAY, "Wait", false, [{1, "Time", "s", 10.0}]},
    {:MAV_CMD_DO_CHANGE_SPEED, "Change speed", false,
     [{1, "Kind (0 air, 1 ground)", nil, 1.0}, {2, "Speed", "m/s", 5.0}]},
    {:MAV_CMD_DO_JUMP, "Jump to item", false, [{1, "To item", nil, 1.0}, {2, "Times", nil, 1.0}]},
    {:MAV_CMD_DO_SET_ROI_LOCATION, "Region of interest", true, []},
    {:MAV_CMD_DO_SET_ROI_NONE, "Clear region of interest", false, []},
    {:MAV_CMD_DO_DIGICAM_CONTROL, "Take a picture", false, []},
    {:MAV_CMD_DO_SET_CAM_TRIGG_DIST, "Pictures by distance", false, [{1, "Every", "m", 10.0}]},
    {:MAV_CMD_IMAGE_START_CAPTURE, "Pictures by time", false,
     [{2, "Every", "s", 2.0}, {3, "Count (0 for unlimited)", nil, 0.0}]},
    {:MAV_CMD_IMAGE_STOP_CAPTURE, "Stop pictures", false, []}
  ]
  @kinds Enum.map(@kinds, &put_elem(&1, 0, MavCmd.value(elem(&1, 0))))
  @by_command Map.new(@kinds, fn {command, name, place?, params} -> {command, {name, place?, params}} end)
  @waypoint MavCmd.value(:MAV_CMD_NAV_WAYPOINT)
  # Its fifth parameter is the shutter.
  @picture MavCmd.value(:MAV_CMD_DO_DIGICAM_CONTROL)
  @looks [MavCmd.value(:MAV_CMD_DO_SET_ROI_LOCATION)]

  @type param :: {1..4, label :: String.t(), unit :: String.t() | nil, default :: float()}

  @doc "The kind that a click adds by default."
  @spec waypoint() :: integer()
  def waypoint, do: @waypoint

  @doc "Kinds whose position is looked at, not flown to."
  @spec looks() :: [integer(), ...]
  def looks, do: @looks

  @doc "The kinds with a position, or those without, for a select."
  @spec options(place? :: boolean()) :: [{String.t(), integer()}]
  def options(place?), do: for({command, name, ^place?, _params} <- @kinds, do: {name, command})

  @doc "The MAV_CMD of a select's value; `:error` for one that is not offered."
  @spec parse(term()) :: {:ok, integer()} | :error
  def parse(text) do
    with true <- is_binary(text),
         {command, ""} <- Integer.parse(text),
         true <- is_map_key(@by_command, command) do
      {:ok, command}
    else
      _other -> :error
    end
  end

  @doc "The name of a kind, or its number."
  @spec name(integer()) :: String.t()
  def name(command) do
    case @by_command do
      %{^command => {name, _place?, _params}} -> name
      _other -> "MAV_CMD #{command}"
    end
  end

  @doc "The meanings of the parameters that are offered; all four by number for an unknown kind."
  @spec params(integer()) :: [param()]
  def params(command) do
    case @by_command do
      %{^command => {_name, _place?, params}} -> params
      _other -> for n <- 1..4, do: {n, "Parameter #{n}", nil, 0.0}
    end
  end

  @doc "An item of a kind with its defaults, without a position."
  @spec item(integer()) :: Item.t()
  def item(command) do
    values = for {n, _label, _unit, default} <- params(command), into: %{}, do: {n, default}
    params = for n <- 1..4, do: Map.get(values, n, 0.0)

    %Item{
      command: command,
      frame: 3,
      params: List.to_tuple(params),
      x: if(command == @picture, do: 1, else: 0)
    }
  end
end
