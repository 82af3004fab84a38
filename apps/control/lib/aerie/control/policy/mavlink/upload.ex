defmodule Aerie.Control.Policy.Mavlink.Upload do
  @moduledoc """
  Where the last item of a mission was while it is uploaded to a vehicle: the vehicle flies straight from item to item, so the way is
  judged with each of them.

  Items come in order (W3). One that comes again is judged from the same item as before; one with a lower number begins again, as
  a MISSION_COUNT does.
  """

  alias Aerie.Control.Policy.Intent
  alias MavCodec.Messages, as: M

  @typedoc "The number and the place of the last item, and the place before it; nil before the first one."
  @type t :: %{seq: non_neg_integer(), place: Intent.place(), before: Intent.place() | nil} | nil

  @doc "The facts of a message of an upload, with the way from the item before it if there is one."
  @spec next(t(), struct(), Intent.t()) :: {Intent.t(), t()}
  def next(last, %module{} = item, %{path: {:at, [place]}} = facts)
      when module in [M.MissionItem, M.MissionItemInt] do
    {way, item} = way(last, item.seq, place)
    {%{facts | path: way}, item}
  end

  # One that an unknown firmware may obey at once or store.
  def next(last, %module{} = item, %{path: {:all, [{:at, [_place]} = stop | others]}} = facts)
      when module in [M.MissionItem, M.MissionItemInt] do
    {stored, last} = next(last, item, %{facts | path: stop})
    {%{facts | path: {:all, [stored.path | others]}}, last}
  end

  def next(_last, %M.MissionCount{}, facts), do: {facts, nil}
  def next(last, _other, facts), do: {facts, last}

  # The way to an item, and where it is.
  defp way(last, seq, place) do
    before =
      case last do
        %{seq: ^seq, before: before} -> before
        %{seq: earlier, place: place} when earlier < seq -> place
        _first -> nil
      end

    # Without a place of its own it is where the one before it is.
    place =
      if place.lat == nil and before != nil, do: %{place | lat: before.lat, lon: before.lon}, else: place

    way = if before, do: {:from, before, place}, else: {:at, [place]}
    {way, %{seq: seq, place: place, before: before}}
  end
end
