defmodule Aerie.Fleet.Tracks.Sample do
  @moduledoc """
  What is kept of a vehicle at a moment, in the units of the file: whole numbers, nil where a value is not known. Pure.

  | field | unit |
  |---|---|
  | `lat`, `lon` | 10⁻⁷ ° |
  | `height` | 0.1 m above home |
  | `heading` | °, 0 to 359 |
  | `speed` | 0.1 m/s over the ground |
  | `age` | seconds since the vehicle was heard, at most 65,535 |
  | `battery` | %, 0 to 100 |
  | `mode` | the firmware's word, at most 32 bytes |
  | `flags` | the sum of 1 armed, 2 in the air, 4 stale, 8 lost |
  """

  import Bitwise

  alias Aerie.Vehicle.Snapshot

  # The numbers that change most often come first: their bits are in the first byte of the mask.
  @numbers [:lat, :lon, :height, :heading, :speed, :age, :battery, :flags]
  @max_age 65_535
  @max_mode 32

  defstruct @numbers ++ [:mode]

  @type t :: %__MODULE__{
          lat: integer() | nil,
          lon: integer() | nil,
          height: integer() | nil,
          heading: integer() | nil,
          speed: integer() | nil,
          age: non_neg_integer() | nil,
          battery: 0..100 | nil,
          flags: 0..15 | nil,
          mode: String.t() | nil
        }

  @doc "The fields that are numbers, in the order of the file."
  @spec numbers() :: [atom()]
  def numbers, do: @numbers

  @doc "A vehicle's sample. `links` are the gateway's, `now` is in unix microseconds."
  @spec of(Snapshot.t(), links :: [map()], now :: integer()) :: t()
  def of(vehicle, links, now) do
    position = Snapshot.data(vehicle, :position)
    mode = Snapshot.data(vehicle, :mode)

    %__MODULE__{
      lat: scaled(position[:lat], 1.0e7, 900_000_000),
      lon: scaled(position[:lon], 1.0e7, 1_800_000_000),
      height: scaled(position[:alt_rel], 10, 10_000_000),
      heading:
        with(
          heading when heading != nil <- scaled(position[:heading], 1, 3600),
          do: Integer.mod(heading, 360)
        ),
      speed: scaled(Snapshot.data(vehicle, :velocity)[:groundspeed], 10, 10_000_000),
      age:
        with(
          us when us != nil <- Snapshot.silent_us(vehicle, links, now),
          do: min(div(us, 1_000_000), @max_age)
        ),
      battery: scaled(Snapshot.data(vehicle, :battery)[:remaining], 100, 100),
      flags: flag(mode[:armed], 1) ||| flag(mode[:in_air], 2) ||| status(vehicle.status),
      mode: word(mode[:mode])
    }
  end

  defp scaled(value, scale, most) when is_number(value) and abs(value) * scale <= most,
    do: round(value * scale)

  defp scaled(_unknown, _scale, _most), do: nil

  defp flag(true, bit), do: bit
  defp flag(_other, _bit), do: 0

  defp status(:stale), do: 4
  defp status(:lost), do: 8
  defp status(_online), do: 0

  defp word(text) when is_binary(text) and text != "" and byte_size(text) <= @max_mode, do: text
  defp word(_none), do: nil

  @doc "Whether the vehicle is in the air and heard."
  @spec flying?(t()) :: boolean()
  def flying?(%{flags: flags}), do: is_integer(flags) and (flags &&& 10) == 2

  @doc "Whether it is lost."
  @spec lost?(t()) :: boolean()
  def lost?(%{flags: flags}), do: is_integer(flags) and (flags &&& 8) == 8

  @doc "The sample in degrees, metres, metres a second and a share of 1, with its time (unix microseconds)."
  @spec show(t(), at :: integer()) :: map()
  def show(%{flags: flags} = sample, at) do
    flags = flags || 0

    %{
      at: at,
      lat: unscaled(sample.lat, 1.0e7),
      lon: unscaled(sample.lon, 1.0e7),
      height: unscaled(sample.height, 10),
      heading: sample.heading,
      speed: unscaled(sample.speed, 10),
      age: sample.age,
      battery: unscaled(sample.battery, 100),
      mode: sample.mode,
      armed: (flags &&& 1) == 1,
      in_air: (flags &&& 2) == 2,
      status: shown(flags)
    }
  end

  defp unscaled(nil, _scale), do: nil
  defp unscaled(value, scale), do: value / scale

  defp shown(flags) when (flags &&& 8) == 8, do: :lost
  defp shown(flags) when (flags &&& 4) == 4, do: :stale
  defp shown(_flags), do: :online
end
