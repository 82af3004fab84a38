defmodule MavRouter.Forward.Cache.EarlyTexts do
  @max_texts 16
  @max_systems 32
  @patience_us 30_000_000

  @moduledoc """
  Texts of systems that are not known to be vehicles yet: those of a booting autopilot come before its first heartbeat and belong to
  it all the same. A pure value.

  At most #{@max_texts} texts of each of #{@max_systems} systems are held, for #{div(@patience_us, 1_000_000)} s; further ones are not.
  """

  alias MavCodec.MessageId
  alias MavCodec.Frame

  @statustext MessageId.of!("STATUSTEXT")

  @typedoc "Frames by system (any term), the newest first."
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

  # The first ones tell what booted.
  defp first(texts), do: texts |> Enum.take(@max_texts) |> Enum.reverse()

  defp room(early, _now) when map_size(early) < @max_systems, do: early
  defp room(early, now), do: Map.filter(early, fn {_system, [newest | _]} -> fresh?(newest, now) end)

  @doc "Takes out the texts of a system that proves to be a vehicle at `now` (unix µs), the oldest first."
  @spec take(t(), system :: term(), now :: integer() | nil) :: {[Frame.t()], t()}
  def take(early, system, now) do
    {texts, early} = Map.pop(early, system, [])
    {texts |> Enum.filter(&fresh?(&1, now)) |> Enum.reverse(), early}
  end

  defp fresh?(%{at: at}, now) when is_integer(at) and is_integer(now), do: abs(now - at) <= @patience_us
  defp fresh?(_untimed, _now), do: true
end
