defmodule Msp.Readings.Value do
  @moduledoc "Numbers of a flight controller, and what MAVLink's fields have for them."

  # What does not fit is not known: a flight controller may send anything.
  @ranges %{
    u8: {0..254, 0xFF},
    u16: {0..0xFFFE, 0xFFFF},
    i16: {-0x7FFF..0x7FFE, 0x7FFF},
    i32: {-0x7FFFFFFF..0x7FFFFFFE, 0x7FFFFFFF},
    # Per cent, and what is positive: -1 is unknown.
    percent: {0..100, -1},
    current: {-0x7FFF..0x7FFF, -1},
    consumed: {0..0x7FFFFFFF, -1},
    place: {-1_800_000_000..1_800_000_000, 0},
    height: {-0x7FFFFFFF..0x7FFFFFFE, 0}
  }

  @doc "A value for a field: times its factor, or the field's number for an unknown one."
  @spec scaled(number | nil, number, atom) :: integer
  def scaled(nil, _factor, kind), do: elem(@ranges[kind], 1)

  def scaled(value, factor, kind) do
    {range, unknown} = @ranges[kind]
    number = round(value * factor)
    if number in range, do: number, else: unknown
  end

  @doc "Degrees in radians."
  @spec radians(number) :: float
  def radians(degrees), do: degrees * :math.pi() / 180

  @doc "Per cent as 0..1."
  @spec percent(number | nil) :: float | nil
  def percent(nil), do: nil
  def percent(value), do: min(value, 100) / 100

  @doc "The strength of a signal as 0..1; 0 where there is no source for it."
  @spec rssi(integer | nil) :: float | nil
  def rssi(value) when value in 1..1023, do: value / 1023
  def rssi(_none), do: nil
end
