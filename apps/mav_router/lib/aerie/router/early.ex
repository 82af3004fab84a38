defmodule Aerie.Router.Early do
  @moduledoc """
  Texts of systems that have not said yet that they are vehicles: what an autopilot says when it boots comes before its first
  heartbeat, and belongs to it all the same. A pure value.

  At most #{16} texts of #{32} systems are held, for #{30} s; what comes past that is not held.
  """

  alias MavCodec.Frame

  @statustext 253
  @max_texts 16
  @max_systems 32
  @patience_us 30_000_000

  @typedoc "Frames by system (whatever names it), the newest first."
  @type t :: %{term() => [Frame.t()]}

  @spec new() :: t()
  def new, do: %{}

  @doc "Holds the texts among frames of a system."
  @spec hold(t(), system :: term(), [Frame.t()]) :: t()
  def hold(early, system, frames) do
    case for(%Frame{id: @statustext, crc_extra: extra} = frame when extra != nil <- frames, do: frame) do
      [] -> early
      texts -> put(early, system, texts)
    end
  end

  defp put(early, system, [%{at: at} | _] = texts) do
    early = if is_map_key(early, system), do: early, else: room(early, at)

    if is_map_key(early, system) or map_size(early) < @max_systems,
      do: Map.update(early, system, first(texts), &first(Enum.reverse(&1) ++ texts)),
      else: early
  end

  # The first ones say what booted.
  defp first(texts), do: texts |> Enum.take(@max_texts) |> Enum.reverse()

  defp room(early, _now) when map_size(early) < @max_systems, do: early
  defp room(early, now), do: Map.filter(early, fn {_system, [newest | _]} -> fresh?(newest, now) end)

  @doc "Takes out what is held of a system that is a vehicle, as it turns out at `now` (unix us): the oldest first."
  @spec take(t(), system :: term(), now :: integer() | nil) :: {[Frame.t()], t()}
  def take(early, system, now) do
    {texts, early} = Map.pop(early, system, [])
    {texts |> Enum.filter(&fresh?(&1, now)) |> Enum.reverse(), early}
  end

  defp fresh?(%{at: at}, now) when is_integer(at) and is_integer(now), do: abs(now - at) <= @patience_us
  defp fresh?(_untimed, _now), do: true
end
