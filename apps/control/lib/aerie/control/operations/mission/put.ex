defmodule Aerie.Control.Operations.Mission.Put do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Control.Missions
  alias Aerie.Control.Operations.Mission.Forms
  alias Aerie.Vehicle.Command.Error

  @max_bytes 4_194_304

  @impl true
  def operation do
    %Operation{
      name: "mission.put",
      meaning: "Writes the mission, the fence or the rally points.",
      changes?: true,
      fields: [kind(), plan(), force()],
      routes: Forms.routes(&route/3)
    }
  end

  defp plan do
    check = &if(is_map(&1), do: {:ok, &1}, else: :error)
    meaning = "a .plan file as an object"
    field(:plan, {:term, check, meaning}, meaning, required: true, schema: ref("plan"))
  end

  defp force do
    meaning = "sends a fence even if the vehicle in flight breaches it at once"
    field(:force, :boolean, meaning, default: false)
  end

  defp route(path, name, options) do
    media = ["text/plain", "application/octet-stream"]
    body = [file: :plan, media: media, query: [:force], max_bytes: @max_bytes]
    put(path, "Writes the #{name} of a vehicle.", body ++ options)
  end

  @impl true
  def prepare(%{plan: given} = input, format) do
    read = if format == "json", do: Forms.read("plan", JSON.encode!(given)), else: Forms.read(format, given)

    case read do
      {:ok, plan} -> {:ok, %{input | plan: plan}}
      {:error, reason} -> {:error, {:invalid, Error.new("plan", reason, :rule)}}
    end
  end

  @impl true
  def run(%{kind: kind, plan: plan, force: force}, context),
    do: Missions.upload(context.gateway, context.vehicle, kind, plan, [force: force] ++ context.options)
end
