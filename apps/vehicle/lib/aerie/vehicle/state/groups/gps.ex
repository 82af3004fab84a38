defmodule Aerie.Vehicle.State.Groups.Gps do
  @moduledoc "The first GNSS receiver."

  alias Aerie.Vehicle.State.{Group, Value}
  alias MavCodec.Enums.GpsFixType
  alias MavCodec.Messages, as: M

  use Group,
    name: :gps,
    title: "The first GNSS receiver.",
    sampling: {:change, 0.5, %{}, 30.0},
    messages: [M.GpsRawInt],
    fields: [
      {:fix, 0, nil, "GPS_FIX_TYPE as a number; 3 or more is a position with height", "GPS_RAW_INT",
       {0, nil}},
      {:fix_name, :text, nil, "GPS_FIX_TYPE: NO_GPS, 2D_FIX, 3D_FIX, RTK_FIXED …", "GPS_RAW_INT"},
      {:satellites, 0, nil, "satellites in view", "GPS_RAW_INT",
       range: {0, nil}, metric: {"gateway_vehicle_satellites", "Satellites in use."}},
      {:hdop, 2, nil, "horizontal dilution of precision", "GPS_RAW_INT", {0, nil}},
      {:vdop, 2, nil, "vertical dilution of precision", "GPS_RAW_INT", {0, nil}},
      {:lat, 7, "°", "the receiver's latitude", "GPS_RAW_INT, HIGH_LATENCY2", -90..90},
      {:lon, 7, "°", "the receiver's longitude", "GPS_RAW_INT, HIGH_LATENCY2", -180..180},
      {:alt_msl, 2, "m", "the receiver's height above mean sea level", "GPS_RAW_INT, HIGH_LATENCY2"},
      {:h_acc, 2, "m", "horizontal uncertainty", "GPS_RAW_INT, HIGH_LATENCY2", {0, nil}},
      {:v_acc, 2, "m", "vertical uncertainty", "GPS_RAW_INT, HIGH_LATENCY2", {0, nil}}
    ]

  @impl Group
  def read(%M.GpsRawInt{} = m, _state, _at) do
    case Value.lat_lon(m.lat, m.lon) do
      :invalid ->
        {:invalid, :gps_raw_int}

      place ->
        {lat, lon} = place || {nil, nil}

        {[],
         gps: %{
           fix: m.fix_type,
           fix_name: GpsFixType.label(m.fix_type) || "FIX(#{m.fix_type})",
           satellites: Value.unsigned(m.satellites_visible, 8),
           hdop: dilution(m.eph),
           vdop: dilution(m.epv),
           lat: lat,
           lon: lon,
           alt_msl: Value.height(place, m.alt, m.alt == 0),
           h_acc: accuracy(m.h_acc),
           v_acc: accuracy(m.v_acc)
         }}
    end
  end

  # Receivers without a fix, and both firmwares with them, say 99.99.
  defp dilution(9_999), do: nil
  defp dilution(value), do: Value.unsigned(value, 16, 100)

  # An extension: zero if the sender does not know it.
  defp accuracy(0), do: nil
  defp accuracy(value), do: Value.unsigned(value, 32, 1000)
end
