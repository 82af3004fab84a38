defmodule Aerie.Control.Policy.Mavlink.Upload do
  @moduledoc """
  Where the last item of a mission was while it is uploaded, for each vehicle, as a plain map: the vehicle flies straight from
  item to item, so the way is judged with each of them.

  Items come in order (W3). One that comes again is judged from the same item as before; one with a lower number begins anew, as
  a MISSION_COUNT does.
  """

  alias Aerie.Control.Policy.Intent
  alias MavCodec.Messages, as: M

  @max_vehicles 100

  @typedoc "The number and the place of the last item, and the place before it."
  @type t :: %{term() => %{seq: non_neg_integer(), place: Intent.place(), before: Intent.place() | nil}}

  @doc "The facts of a message of an upload, with the way from the item before it if there is one."
  @spec next(t(), vehicle :: term(), struct(), Intent.t()) :: {Intent.t(), t()}
  def next(uploads, vehicle, %module{} = item, %{path: {:at, [place]}} = facts)
      when module in [M.MissionItem, M.MissionItemInt] do
    {way, _place, uploads} = way(uploads, vehicle, item.seq, place)
    {%{facts | path: way}, uploads}
  end

  def next(
        uploads,
        vehicle,
        %module{} = item,
        %{path: {:all, [{:at, [place]}, {:ring, place, metres}]}} = facts
      )
      when module in [M.MissionItem, M.MissionItemInt] do
    {way, place, uploads} = way(uploads, vehicle, item.seq, place)
    {%{facts | path: {:all, [way, {:ring, place, metres}]}}, uploads}
  end

  def next(uploads, vehicle, %M.MissionCount{}, facts), do: {facts, Map.delete(uploads, vehicle)}
  def next(uploads, _vehicle, _other, facts), do: {facts, uploads}

  # The way to an item, and its place.
  defp way(uploads, vehicle, seq, place) do
    before =
      case uploads do
        %{^vehicle => %{seq: ^seq, before: before}} -> before
        %{^vehicle => %{seq: last, place: place}} when last < seq -> place
        _first -> nil
      end

    # Without a place of its own it is where the one before it is.
    place =
      if place.lat == nil and before != nil, do: %{place | lat: before.lat, lon: before.lon}, else: place

    uploads = if map_size(uploads) >= @max_vehicles, do: %{}, else: uploads
    way = if before, do: {:from, before, place}, else: {:at, [place]}
    {way, place, Map.put(uploads, vehicle, %{seq: seq, place: place, before: before})}
  end
end
