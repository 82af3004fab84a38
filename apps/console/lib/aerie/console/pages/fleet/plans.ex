defmodule Aerie.Console.Pages.Fleet.Plans do
  @moduledoc """
  The missions, fences and rally points that the map shows, of the vehicles for which somebody switched them on. Reading them costs the link
  something, so nothing is read before that; equal readings of several pages are one (`Aerie.Control.Missions`). Pure but for the tasks that read.
  """

  alias Aerie.Base.Names
  alias Aerie.Control.Missions
  alias Protocols.Mission.Plan
  alias Aerie.Console.Pages.Plan.MapPayload

  # Each waits for a transfer of its vehicle.
  @most 20

  defstruct shown: %{}

  @typedoc "By vehicle: what it is read for (`ref`), what was read so far, what could not be."
  @type t :: %__MODULE__{
          shown: %{
            String.t() => %{
              ref: reference(),
              reading: boolean(),
              plan: Plan.t(),
              count: term(),
              errors: [String.t()]
            }
          }
        }

  @doc "How many vehicles' plans are shown at most."
  @spec most() :: pos_integer()
  def most, do: @most

  @doc "Whether a vehicle's plans are switched on."
  @spec on?(t(), String.t()) :: boolean()
  def on?(plans, id), do: is_map_key(plans.shown, id)

  @doc """
  Switches the plans of vehicles on, or off if all of them are on. The calling process gets `{:plan, id, ref, message}` for `update/4`. `counts`:
  how many items each mission has, as far as its state tells.
  """
  @spec toggle(t(), Names.gateway(), [String.t()], %{String.t() => term()}) :: t()
  def toggle(plans, gateway, ids, counts) do
    if Enum.all?(ids, &on?(plans, &1)),
      do: %{plans | shown: Map.drop(plans.shown, ids)},
      else: ids |> Enum.reject(&on?(plans, &1)) |> Enum.reduce(plans, &read(&2, gateway, &1, counts[&1]))
  end

  @doc "Forgets vehicles that are gone, and reads missions again whose number of items has changed."
  @spec keep(t(), Names.gateway(), %{String.t() => term()}) :: t()
  def keep(plans, gateway, counts) do
    shown = Map.take(plans.shown, Map.keys(counts))

    Enum.reduce(shown, %{plans | shown: shown}, fn {id, entry}, plans ->
      if entry.reading or entry.count == counts[id], do: plans, else: read(plans, gateway, id, counts[id])
    end)
  end

  defp read(%{shown: shown} = plans, _gateway, id, _count)
       when map_size(shown) >= @most and not is_map_key(shown, id),
       do: plans

  defp read(plans, gateway, id, count) do
    {page, ref} = {self(), make_ref()}

    {:ok, _pid} =
      Task.start(fn ->
        for kind <- Missions.kinds(),
            do: send(page, {:plan, id, ref, {kind, Missions.download(gateway, id, kind)}})

        send(page, {:plan, id, ref, :done})
      end)

    entry = %{ref: ref, reading: true, plan: %Plan{}, count: count, errors: []}
    put_in(plans.shown[id], entry)
  end

  @doc "After a message of a task; one of an earlier reading changes nothing."
  @spec update(t(), String.t(), reference(), term()) :: t()
  def update(plans, id, ref, message) do
    case plans.shown do
      %{^id => %{ref: ^ref} = entry} -> put_in(plans.shown[id], updated(entry, message))
      _earlier -> plans
    end
  end

  defp updated(entry, :done), do: %{entry | reading: false}

  defp updated(entry, {kind, {:ok, %{plan: plan}}}),
    do: %{entry | plan: Plan.put_part(entry.plan, kind, plan)}

  defp updated(entry, {kind, {:error, %{reason: reason, status: status}}}),
    do: %{entry | errors: entry.errors ++ ["#{kind}: #{reason || status}"]}

  @doc "The payload of `map:plans`. `current`: the number of the item that each vehicle flies to."
  @spec payload(t(), %{String.t() => term()}) :: [map()]
  def payload(plans, current) do
    for {id, %{plan: plan}} <- Enum.sort_by(plans.shown, &elem(&1, 0)),
        do: plan |> MapPayload.aboard() |> Map.merge(%{vehicle: id, current: current[id]})
  end

  @doc "Texts of what is under way or went wrong; `[]` for nothing."
  @spec summary(t()) :: [String.t()]
  def summary(plans) do
    for {id, entry} <- Enum.sort_by(plans.shown, &elem(&1, 0)),
        words = if(entry.reading, do: "reading its plans …", else: wrong(entry.errors)),
        do: "#{id}: #{words}"
  end

  defp wrong([]), do: nil
  defp wrong(errors), do: Enum.join(errors, "; ")
end
