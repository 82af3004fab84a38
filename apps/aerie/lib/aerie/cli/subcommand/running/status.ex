defmodule Aerie.CLI.Subcommand.Running.Status do
  @moduledoc """
  `aerie status`: vehicles, links, NATS and problems, from the read model.

  A gateway that waits for a radio is ready (`Aerie.Fleet.Health`), and all the same something is wrong: the exit status
  says so.
  """
  @behaviour Aerie.CLI.Subcommand

  alias Aerie.CLI.Status
  alias Aerie.CLI.Output.Columns
  alias Aerie.Api.Rest.View
  alias Aerie.Base.{Json, Store}
  alias Aerie.Fleet.Health

  @impl Aerie.CLI.Subcommand
  def run(%{options: options}) do
    {ready?, health} = Health.ready(:default)
    own = Aerie.Vehicle.Settings.of(:default).identity.vehicle_id
    missing = missing(health.links, Store.vehicles(:default), own)
    conditions = View.diagnosis(:default).conditions
    health = Map.update!(health, :problems, &(&1 ++ missing))
    json = :default |> View.status() |> Map.merge(%{health: health, conditions: conditions}) |> Json.encode!()
    text = if options[:json], do: [json, ?\n], else: render(JSON.decode!(json), Status.View.collect(:default))
    well? = ready? and missing == [] and not Enum.any?(conditions, &(&1.severity == :error))
    {if(well?, do: 0, else: 1), text}
  end

  @doc "What a gateway waits for: links that are not up, and the vehicle aboard which it runs (nil: none). Pure."
  @spec missing([map()], [map()], String.t() | nil) :: [String.t()]
  def missing(links, vehicles, own) do
    down =
      for %{status: status} = link <- links,
          status in [:down, :connecting],
          do: "link #{link.id}: #{link.text}"

    heard? = own == nil or Enum.any?(vehicles, &(&1.id == own and &1.status == :online))
    if heard?, do: down, else: down ++ ["#{own}, aboard which this gateway runs (vehicle_id), is not heard"]
  end

  @doc """
  The status as text. Pure; `status` is what `--json` prints: that of `GET /api/status` with `health` and `conditions`.
  """
  @spec render(map(), Status.View.t()) :: iodata()
  def render(status, view) do
    [
      head(status),
      "\n",
      Status.Table.vehicles(view),
      "\n",
      Status.Table.links(view),
      for(condition <- status["conditions"], do: condition(condition))
    ]
  end

  defp head(%{"health" => %{"nats" => nats} = health} = status) do
    place = if nats["url"], do: " #{Columns.cell(nats["url"])}", else: ""
    waiting = if nats["outbox"] in [nil, 0], do: "", else: ", #{nats["outbox"]} events wait"

    problems = [
      nats["problem"],
      if(nats["hub"]["stores"] == false, do: "the hub does not store events: #{nats["hub"]["problem"]}"),
      health["identity"]["alarm"],
      health["audit"]["problem"],
      health["policy"]["problem"]
    ]

    [
      "#{health["status"]}: #{counted(status["vehicles"], "vehicle")}, #{counted(status["links"], "link")}\n",
      "NATS #{if nats["connected"], do: "connected", else: "not connected"}#{place}#{waiting}\n",
      hub(nats["hub"]),
      for(
        problem <- problems ++ health["problems"],
        problem != nil,
        do: "problem: #{Columns.cell(problem)}\n"
      )
    ]
  end

  defp counted([_one], name), do: "1 #{name}"
  defp counted(list, name), do: "#{length(list)} #{name}s"

  defp hub(nil), do: []

  defp hub(hub),
    do:
      "hub #{if hub["connected"], do: "connected", else: "not connected"}" <>
        if(hub["waiting"] == 0, do: "\n", else: ", #{hub["waiting"]} events wait\n")

  defp condition(condition) do
    subject = if condition["id"], do: "#{condition["subject"]} #{condition["id"]}: ", else: ""

    [
      "\n#{condition["severity"]}: #{Columns.cell(subject <> condition["title"])}\n",
      for(line <- condition["evidence"], do: "  #{Columns.cell(line)}\n"),
      "  fix: #{Columns.cell(condition["mend"])}\n"
    ]
  end
end
