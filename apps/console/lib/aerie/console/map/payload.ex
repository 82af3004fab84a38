defmodule Aerie.Console.Map.Payload do
  @moduledoc """
  The vehicles for the map: short rows, and of those only the changed ones. Pure.
  """

  alias Aerie.Vehicle.Snapshot

  @typedoc """
  `[id, lat, lon, heading, course, speed, height, kind, state, in_air, tag, urgent]`: degrees, m/s, metres above home;
  nil where not known. The tag gives the symbol's colour; an urgent one is not put into a cluster.
  """
  @type row :: [term(), ...]
  @type sent :: %{String.t() => row()}

  @doc "The row of a vehicle's snapshot; nil while its position is not known."
  @spec row(map(), tag :: String.t() | nil, urgent :: boolean()) :: row() | nil
  def row(%{groups: groups} = vehicle, tag \\ nil, urgent? \\ false) do
    with %{position: %{data: %{lat: lat, lon: lon} = position}} when is_number(lat) and is_number(lon) <-
           groups do
      velocity = Snapshot.data(vehicle, :velocity)
      {course, speed} = over_ground(velocity)

      [
        vehicle.id,
        rounded(lat, 7),
        rounded(lon, 7),
        rounded(position[:heading], 0),
        course,
        rounded(speed, 1),
        rounded(position[:alt_rel], 1),
        vehicle.vehicle_type,
        state(vehicle),
        Snapshot.data(vehicle, :mode)[:in_air] == true,
        tag,
        urgent?
      ]
    else
      _no_position -> nil
    end
  end

  @doc """
  How a vehicle is drawn: `lost` and `stale` come first, because then nothing else is known; then `failsafe`,
  `armed`, `disarmed`.
  """
  @spec state(map()) :: :lost | :stale | :failsafe | :armed | :disarmed
  def state(%{status: status}) when status in [:lost, :stale], do: status

  def state(vehicle) do
    case Snapshot.data(vehicle, :mode) do
      %{failsafe: true} -> :failsafe
      %{armed: true} -> :armed
      _other -> :disarmed
    end
  end

  @doc "The payload of `map:vehicles` without `map`, nil if nothing has changed; and the map's new content."
  @spec changes(sent(), [row()]) :: {map() | nil, sent()}
  def changes(sent, rows) do
    new = Map.new(rows, fn [id | _] = row -> {id, row} end)
    changed = for [id | _] = row <- rows, sent[id] != row, do: row
    gone = for {id, _row} <- sent, not is_map_key(new, id), do: id

    cond do
      sent == %{} and rows != [] -> {%{all: true, vehicles: rows, gone: []}, new}
      changed == [] and gone == [] -> {nil, new}
      true -> {%{all: false, vehicles: changed, gone: Enum.sort(gone)}, new}
    end
  end

  defmodule Encoded do
    @moduledoc "Rows that are JSON already, so that they are encoded once for all pages."
    defstruct [:json]

    defimpl JSON.Encoder do
      def encode(%{json: json}, _encoder), do: json
    end
  end

  @doc "A list of rows, each of which is JSON already."
  @spec encoded([binary()]) :: struct()
  def encoded(rows),
    do: %Encoded{json: IO.iodata_to_binary(["[", Enum.intersperse(rows, ","), "]"])}

  @doc """
  Where a vehicle's home is drawn, to about a metre: vehicles that stand together share one symbol. Nil where it is
  not known.
  """
  @spec home(map()) :: [float()] | nil
  def home(%{groups: %{home: %{data: %{lat: lat, lon: lon}}}}) when is_number(lat) and is_number(lon),
    do: [rounded(lat, 5), rounded(lon, 5)]

  def home(_vehicle), do: nil

  @doc "The homes, each position once, at most 200."
  @spec homes([[float()] | nil]) :: [[float()]]
  def homes(homes), do: for(home when home != nil <- homes, uniq: true, do: home) |> Enum.take(200)

  defp over_ground(%{vn: north, ve: east} = velocity) when is_number(north) and is_number(east) do
    speed = velocity[:groundspeed]
    speed = if is_number(speed), do: speed, else: :math.sqrt(north * north + east * east)
    course = :math.atan2(east, north) * 180 / :math.pi()
    {rounded(if(course < 0, do: course + 360, else: course), 0), speed}
  end

  defp over_ground(velocity), do: {nil, velocity[:groundspeed]}

  defp rounded(value, 0) when is_number(value), do: round(value)
  defp rounded(value, decimals) when is_number(value), do: Float.round(value / 1, decimals)
  defp rounded(_unknown, _decimals), do: nil
end
