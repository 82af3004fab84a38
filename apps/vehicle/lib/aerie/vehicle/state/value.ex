defmodule Aerie.Vehicle.State.Value do
  @moduledoc """
  Converts numbers of messages to values with a unit; "unknown" becomes nil, never a number.

  Each MAVLink field has its own number for "unknown" (the largest unsigned, the largest signed, -1, NaN). An impossible value
  (a latitude of 95°) is `:invalid`.
  """

  @doc "An unsigned field whose largest value means unknown, scaled."
  @spec unsigned(integer(), 8 | 16 | 32, number()) :: number() | nil
  def unsigned(value, bits, scale \\ 1)
  def unsigned(0xFF, 8, _scale), do: nil
  def unsigned(0xFFFF, 16, _scale), do: nil
  def unsigned(0xFFFFFFFF, 32, _scale), do: nil
  def unsigned(value, _bits, scale), do: scaled(value, scale)

  @doc "A signed field whose largest value means unknown, scaled. So is its lowest, which no sender measures."
  @spec signed(integer(), 16 | 32, number()) :: number() | nil
  def signed(value, bits, scale \\ 1)
  def signed(value, 16, _scale) when value in [0x7FFF, -0x8000], do: nil
  def signed(value, 32, _scale) when value in [0x7FFFFFFF, -0x80000000], do: nil
  def signed(value, _bits, scale), do: scaled(value, scale)

  @doc """
  A height in millimetres beside a place: before an autopilot knows where it is, it sends zeros, but a barometer may know the height
  without a receiver. nil for 0 without a place.
  """
  @spec height({float(), float()} | nil, integer(), zero? :: boolean()) :: float() | nil
  def height(nil, _value, true), do: nil
  def height(_place, value, _zero?), do: millimetres(value)

  @doc "A field in which -1 means unknown, scaled."
  @spec or_minus_one(integer(), number()) :: number() | nil
  def or_minus_one(value, scale \\ 1)
  def or_minus_one(-1, _scale), do: nil
  def or_minus_one(value, scale), do: scaled(value, scale)

  @doc "A field in which 0 means unknown, scaled."
  @spec or_zero(integer(), number()) :: number() | nil
  def or_zero(value, scale \\ 1)
  def or_zero(0, _scale), do: nil
  def or_zero(value, scale), do: scaled(value, scale)

  @doc "A number up to `most`, scaled; more is unknown."
  @spec up_to(non_neg_integer(), pos_integer(), number()) :: number() | nil
  def up_to(value, most, scale), do: if(value <= most, do: value / scale)

  @doc "A float; NaN and the infinities are unknown."
  @spec float(term()) :: float() | nil
  def float(value) when is_float(value), do: value
  def float(_not_a_number), do: nil

  @doc "Radians as degrees."
  @spec degrees(term()) :: float() | nil
  def degrees(value) when is_float(value), do: value * 57.29577951308232
  def degrees(_not_a_number), do: nil

  @doc """
  Latitude and longitude in degrees from 1e-7 degrees. nil if both are 0, which autopilots send before they know the position;
  `:invalid` if out of range.
  """
  @spec lat_lon(integer(), integer()) :: {float(), float()} | nil | :invalid
  def lat_lon(0, 0), do: nil
  def lat_lon(0x7FFFFFFF, _lon), do: nil
  def lat_lon(_lat, 0x7FFFFFFF), do: nil

  def lat_lon(lat, lon) when lat in -900_000_000..900_000_000 and lon in -1_800_000_000..1_800_000_000 do
    {lat / 1.0e7, lon / 1.0e7}
  end

  def lat_lon(_lat, _lon), do: :invalid

  @doc "Millimetres as metres; values beyond 1000 km are unknown."
  @spec millimetres(integer()) :: float() | nil
  def millimetres(value) when value in -1_000_000_000..1_000_000_000, do: value / 1000
  def millimetres(_value), do: nil

  defp scaled(value, 1), do: value
  defp scaled(value, scale), do: value / scale
end
