defmodule MavCodec.Meaning.Shaping do
  @moduledoc """
  The parameters that shape the path of a vehicle: how wide it circles and turns, how high it climbs by itself. Each
  has a row that says what it shapes. Names of the same families without a row may shape anything.
  """

  @typedoc """
    * `:shapes` - a width, a height, or the path in another way; a speed, which leaves it as it is
    * `:metres` - metres of its unit, nil where no length is meant
    * `:assumed` - how many metres count as long as the vehicle has not told its value: more than people set. nil:
      nobody asks for it
  """
  @type row :: %{
          name: String.t(),
          shapes: :width | :height | :path | :speed,
          metres: number() | nil,
          meaning: String.t(),
          assumed: number() | nil
        }

  @rows Map.new(
          [
            {"WP_LOITER_RAD", :width, 1, "the circle of a plane at a place", 300},
            {"RTL_RADIUS", :width, 1, "the circle of a plane at home"},
            {"WP_RADIUS", :width, 1, "how early a plane or rover turns at a waypoint", 150},
            {"WP_RADIUS_M", :width, 1, "how near a copter passes a waypoint", 10},
            {"WP_MAX_RADIUS", :width, 1, "how far beside a waypoint a plane passes it"},
            {"WPNAV_RADIUS", :width, 0.01, "how near a copter passes a waypoint", 10},
            {"CIRCLE_RADIUS", :width, 0.01, "the circle of a copter", 60},
            {"CIRCLE_RADIUS_M", :width, 1, "the circle of a copter", 60},
            {"LOIT_RADIUS", :width, 1, "how far a rover drifts from a place", 50},
            {"NAV_LOITER_RAD", :width, 1, "the circle of a plane at a place", 300},
            {"RTL_LOITER_RAD", :width, 1, "the circle of a plane at home"},
            {"NAV_ACC_RAD", :width, 1, "how early it turns at a waypoint", 30},
            {"MC_ORBIT_RAD_MAX", :width, 1, "the largest circle of a copter"},
            {"RTL_ALT", :height, 0.01, "the height of the way home"},
            {"RTL_ALT_M", :height, 1, "the height of the way home"},
            {"RTL_ALTITUDE", :height, 1, "the height of the way home"},
            {"ALT_HOLD_RTL", :height, 0.01, "the height of the way home"},
            {"RTL_ALT_FINAL", :height, 0.01, "the height above home at the end of the way"},
            {"RTL_ALT_FINAL_M", :height, 1, "the height above home at the end of the way"},
            {"RTL_CLIMB_MIN", :height, 0.01, "how far it climbs before it flies home"},
            {"RTL_CLIMB_MIN_M", :height, 1, "how far it climbs before it flies home"},
            {"RTL_RETURN_ALT", :height, 1, "the height of the way home"},
            {"RTL_DESCEND_ALT", :height, 1, "the height above home at the end of the way"},
            {"Q_RTL_ALT", :height, 1, "the height of the way home on rotors"},
            {"TKOFF_ALT", :height, 1, "the height of a take-off"},
            {"TKOFF_DIST", :width, 1, "how far a plane flies to climb"},
            {"PILOT_TKOFF_ALT", :height, 0.01, "the height of a take-off"},
            {"MIS_TAKEOFF_ALT", :height, 1, "the height of a take-off"},
            {"VTO_LOITER_ALT", :height, 1, "the height at which it circles after a take-off"},
            {"MIS_LND_ABRT_ALT", :height, 1, "how high a plane climbs when a landing is aborted", 100},
            {"NAV_MIN_LTR_ALT", :height, 1, "the least height of a circle"},
            {"MIS_LTRMIN_ALT", :height, 1, "the least height of a circle"},
            {"LAND_ALT_LOW", :height, 0.01, "where a landing slows down"},
            {"LAND_ALT_LOW_M", :height, 1, "where a landing slows down"},
            {"WPNAV_SPEED", :speed, nil, "a speed"},
            {"WPNAV_SPEED_UP", :speed, nil, "a speed"},
            {"WPNAV_SPEED_DN", :speed, nil, "a speed"},
            {"WPNAV_ACCEL", :speed, nil, "a speed"},
            {"WP_SPEED", :speed, nil, "a speed"},
            {"WP_SPD", :speed, nil, "a speed"},
            {"WP_SPD_UP", :speed, nil, "a speed"},
            {"WP_SPD_DN", :speed, nil, "a speed"},
            {"RTL_SPEED", :speed, nil, "a speed"},
            {"RTL_SPEED_MS", :speed, nil, "a speed"},
            {"LAND_SPEED", :speed, nil, "a speed"},
            {"LAND_SPEED_HIGH", :speed, nil, "a speed"},
            {"LAND_SPD_MS", :speed, nil, "a speed"},
            {"LAND_SPD_HIGH_MS", :speed, nil, "a speed"},
            {"LOIT_SPEED", :speed, nil, "a speed"},
            {"LOIT_SPEED_MS", :speed, nil, "a speed"},
            {"RTL_CONE_SLOPE", :path, nil, "how high it climbs by its distance from home"},
            {"RTL_CONE_ANG", :path, nil, "how high it climbs by its distance from home"},
            {"RTL_TYPE", :path, nil, "by which way it comes home"},
            {"RTL_AUTOLAND", :path, nil, "by which way it comes home"},
            {"RTL_ALT_TYPE", :path, nil, "what the height of the way home is above"},
            {"TERRAIN_ENABLE", :path, nil, "what heights are above"},
            {"TERRAIN_FOLLOW", :path, nil, "what heights are above"}
          ],
          fn row ->
            [name, shapes, metres, meaning | more] = Tuple.to_list(row)
            {name, %{name: name, shapes: shapes, metres: metres, meaning: meaning, assumed: List.first(more)}}
          end
        )

  @wide 300

  # Families of such parameters; `*` stands for any characters.
  @families ~w(WP_* WPNAV_* RTL_* LOIT_* CIRCLE_* TKOFF_* LAND_* TERRAIN_* ALT_HOLD_RTL NAVL1_* RALLY_* AUTO_* GUIDED_*
    GUID_* SCURVE_* PILOT_TKOFF* FOLL_* SRTL_* PLND_* ZIGZ_* Q_RTL_* Q_LAND_* Q_WP_* Q_LOIT_* Q_OPTIONS Q_GUIDED_*
    Q_TRANS_* RNGFND_LANDING NAV_* MIS_* VTO_* FLW_TGT_* FW_LND_* FW_TKO_* NPFG_* MC_ORBIT_* VT_TRANS_* MPC_LAND_*
    MPC_TKO_* MPC_XY_ERR* INAV_MC_* FW_AUTOLAND_*)
            |> Enum.map(&String.split(&1, "*"))

  @doc "All rows."
  @spec all() :: [row(), ...]
  def all, do: @rows |> Map.values() |> Enum.sort_by(& &1.name)

  @doc "The row of a parameter; `:unknown` for one of a family without a row, nil for one that shapes no path."
  @spec get(String.t()) :: row() | :unknown | nil
  def get(name) do
    [name | _rest] = :binary.split(name, <<0>>)
    name = String.upcase(name, :ascii)
    Map.get(@rows, name) || if(Enum.any?(@families, &family?(&1, name)), do: :unknown)
  end

  defp family?([name], name), do: true
  defp family?([start, ""], name), do: String.starts_with?(name, start)
  defp family?(_other, _name), do: false

  @doc "Whether a parameter shapes a path, as far as is known."
  @spec shapes?(String.t()) :: boolean()
  def shapes?(name) do
    row = get(name)
    row == :unknown or (row != nil and row.shapes != :speed)
  end

  @doc "Metres of a parameter by its value, or assumed because the value is not known, and which of both."
  @spec metres(String.t(), %{String.t() => number()}, assumed :: number() | nil) ::
          {:known | :assumed, float()}
  def metres(name, params, assumed \\ nil) do
    row = Map.fetch!(@rows, name)

    case params do
      %{^name => value} when is_number(value) -> {:known, abs(value) * row.metres * 1.0}
      _unknown -> {:assumed, (assumed || row.assumed || @wide) * 1.0}
    end
  end
end
