defmodule SimVehicle.Firmware.Px4.Events do
  @moduledoc """
  PX4's event interface (EVENT 410-413, rule X3) and the STATUSTEXT that doubles most events.

  Ids, levels and argument layouts are those of 1.17.0. The sequence starts at 65526, so that it wraps soon after boot. The
  last 100 events can be requested again.
  """

  alias MavCodec.Messages, as: M
  alias SimVehicle.{Real32, Vehicle}
  alias SimVehicle.Services.{Telemetry, Texts}

  @first_sequence 65_526
  @kept 100
  @texts_kept 20
  @gcs_silent_us 5_000_000
  @arguments 40

  # name => {id, log levels (internal << 4 | external), argument types}
  @known %{
    log_opened: {17_980_399, 0x66, [:u16, :u8, :u8, :u8, :u8, :u8]},
    armed: {26_266_355, 0x66, [:u8]},
    disarmed: {32_794_487, 0x66, [:u8]},
    takeoff: {21_054_825, 0x66, []},
    landing_detected: {26_622_124, 0x66, []},
    landing_here: {20_099_806, 0x66, []},
    returning: {20_262_116, 0x66, []},
    return_altitude: {22_161_044, 0x66, [:i32, :u8]},
    return_landing: {16_962_474, 0x66, []},
    mission_executing: {32_375_217, 0x66, []},
    mission_finished: {21_455_606, 0x66, []},
    mission_denied: {23_844_490, 0x62, []},
    mission_takeoff_missing: {22_271_714, 0x63, []},
    mission_item_invalid: {33_469_040, 0x33, []},
    first_waypoint_far: {22_091_529, 0x64, [:u32]},
    arming_denied_calibrating: {18_843_603, 0x62, []},
    arming_denied: {16_910_493, 0x62, []},
    disarming_denied: {25_868_725, 0x62, []},
    mode_unavailable: {27_280_279, 0x62, [:u32, :u8]},
    mode_unsupported: {19_869_445, 0x33, []},
    arm_argument: {19_217_309, 0x33, [:f32]},
    battery_low: {28_993_875, 0x64, []},
    gcs_lost: {27_571_288, 0x64, []},
    gcs_regained: {31_011_876, 0x66, []},
    rc_lost: {22_400_324, 0x66, []},
    rc_regained: {17_490_621, 0x66, [:f32]},
    failsafe_hold: {30_481_910, 0x42, [:u32, :u8, :u16, :u8]},
    failsafe: {26_528_394, 0x42, [:u32, :u8, :u8]},
    geofence_invalid: {27_750_677, 0x42, []}
  }

  @doc "An event, with the text that doubles it (nil for none)."
  @spec emit(Vehicle.t(), atom, [number], {0..7, String.t()} | nil) :: Vehicle.t()
  def emit(v, name, arguments \\ [], text \\ nil) do
    {id, levels, types} = Map.fetch!(@known, name)
    sequence = Vehicle.own(v, :event_sequence, @first_sequence)

    event = %M.Event{
      id: id,
      event_time_boot_ms: Telemetry.boot_ms(v),
      sequence: sequence,
      log_levels: levels,
      arguments: pack(types, arguments)
    }

    v
    |> double(text)
    |> Vehicle.put_own(:event_sequence, rem(sequence + 1, 65_536))
    |> Vehicle.put_own(:events, Enum.take([event | Vehicle.own(v, :events, [])], @kept))
    |> Vehicle.emit(event)
  end

  @doc "CURRENT_EVENT_SEQUENCE: the newest sequence, flagged while there was no event since boot."
  @spec current(Vehicle.t()) :: struct
  def current(v) do
    sequence = Vehicle.own(v, :event_sequence, @first_sequence)
    flags = if Vehicle.own(v, :events, []) == [], do: 1, else: 0
    %M.CurrentEventSequence{sequence: rem(sequence + 65_535, 65_536), flags: flags}
  end

  @doc "Answers REQUEST_EVENT: each event again, or an error with the oldest kept sequence."
  @spec again(Vehicle.t(), struct, {integer, integer}) :: Vehicle.t()
  def again(v, m, {system, component}) do
    kept = Vehicle.own(v, :events, [])
    count = rem(m.last_sequence - m.first_sequence + 65_536, 65_536) + 1

    Enum.reduce(0..(min(count, @kept) - 1), v, fn offset, v ->
      wanted = rem(m.first_sequence + offset, 65_536)

      case Enum.find(kept, &(&1.sequence == wanted)) do
        nil -> Vehicle.emit(v, missing(kept, wanted, system, component))
        event -> Vehicle.emit(v, event)
      end
    end)
  end

  @doc """
  A text with id and chunks. Texts are held back while no ground station's heartbeat was heard for five seconds; the
  oldest is lost if there are more than twenty.
  """
  @spec text(Vehicle.t(), 0..7, String.t()) :: Vehicle.t()
  def text(v, severity, text) do
    id = v.text_id

    chunks =
      for {chunk, seq} <- Enum.with_index(Texts.split(text)) do
        %M.Statustext{severity: severity, text: chunk, id: id, chunk_seq: seq}
      end

    v = %{v | text_id: rem(id + 1, 65_536)}

    if gcs?(v),
      do: Enum.reduce(chunks, v, &Vehicle.emit(&2, &1)),
      else:
        Vehicle.put_own(v, :held_texts, Enum.take([chunks | Vehicle.own(v, :held_texts, [])], @texts_kept))
  end

  @doc "Sends the held texts, now that a ground station can read them."
  @spec release(Vehicle.t()) :: Vehicle.t()
  def release(v) do
    held = v |> Vehicle.own(:held_texts, []) |> Enum.reverse() |> List.flatten()
    Enum.reduce(held, Vehicle.put_own(v, :held_texts, []), &Vehicle.emit(&2, &1))
  end

  defp gcs?(v), do: v.gcs_heard != nil and v.now - v.gcs_heard < @gcs_silent_us

  # The tab tells a ground station that the text is also an event.
  defp double(v, nil), do: v
  defp double(v, {severity, text}), do: Vehicle.text(v, severity, text <> "\t")

  defp missing(kept, wanted, system, component) do
    oldest = if kept == [], do: @first_sequence, else: List.last(kept).sequence

    %M.ResponseEventError{
      target_system: system,
      target_component: component,
      sequence: wanted,
      sequence_oldest_available: oldest
    }
  end

  defp pack(types, arguments) do
    packed = for {type, value} <- Enum.zip(types, arguments), into: <<>>, do: pack_one(type, value)
    packed <> <<0::size((@arguments - byte_size(packed)) * 8)>>
  end

  defp pack_one(:u8, value), do: <<value::8>>
  defp pack_one(:u16, value), do: <<value::little-16>>
  defp pack_one(:u32, value), do: <<value::little-32>>
  defp pack_one(:i32, value), do: <<value::little-signed-32>>

  defp pack_one(:f32, value) do
    bits = Real32.to_bits(value)
    <<bits::little-32>>
  end
end
