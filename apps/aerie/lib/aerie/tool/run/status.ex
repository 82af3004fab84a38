defmodule Aerie.Tool.Run.Status do
  @moduledoc "`aerie status`: vehicles, links, NATS and problems, from the read model."
  @behaviour Aerie.Tool.Subcommand

  alias Aerie.Tool.Columns
  alias FleetWeb.API.View
  alias Aerie.Fleet.Health

  @impl Aerie.Tool.Subcommand
  def run(%{options: options}) do
    {ready?, health} = Health.ready(:default)

    status =
      :default
      |> View.status()
      |> Map.merge(%{health: health, conditions: View.diagnosis(:default).conditions})

    json = JSON.encode!(status)
    {if(ready?, do: 0, else: 1), if(options[:json], do: [json, ?\n], else: render(JSON.decode!(json)))}
  end

  @doc "The status as text. Pure; `status` is what `--json` prints: that of `GET /api/status` with `health` and `conditions`."
  @spec render(map()) :: iodata()
  def render(status) do
    [
      head(status),
      "\n",
      Columns.render(
        ~w(VEHICLE STATUS TYPE MODE ARMED LATITUDE LONGITUDE HEIGHT BATTERY AGE VIA),
        Enum.map(status["vehicles"], &vehicle/1)
      ),
      if(status["vehicles"] == [], do: "no vehicle was heard\n", else: []),
      "\n",
      Columns.render(
        ~w(LINK STATUS NETWORK TEXT),
        for(l <- status["links"], do: [l["id"], l["status"], l["network"], l["text"]])
      ),
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
      "#{health["status"]}: #{length(status["vehicles"])} vehicles, #{length(status["links"])} links\n",
      "NATS #{if nats["connected"], do: "connected", else: "not connected"}#{place}#{waiting}\n",
      hub(nats["hub"]),
      for(
        problem <- problems ++ health["problems"],
        problem != nil,
        do: "problem: #{Columns.cell(problem)}\n"
      )
    ]
  end

  defp hub(nil), do: []

  defp hub(hub),
    do:
      "hub #{if hub["connected"], do: "connected", else: "not connected"}" <>
        if(hub["waiting"] == 0, do: "\n", else: ", #{hub["waiting"]} events wait\n")

  defp vehicle(vehicle) do
    [
      vehicle["vehicle"],
      vehicle["status"],
      type(Enum.reject([vehicle["type"], vehicle["autopilot"]], &is_nil/1)),
      vehicle["mode"],
      armed(vehicle["armed"]),
      vehicle["position"]["lat"],
      vehicle["position"]["lon"],
      unit(vehicle["position"]["alt_rel"], "m"),
      percent(vehicle["battery"]["remaining"]),
      unit(vehicle["age"], "s"),
      vehicle["via"]
    ]
  end

  defp type([]), do: nil
  defp type(words), do: Enum.join(words, " ")

  defp armed(nil), do: nil
  defp armed(armed), do: if(armed, do: "ARMED", else: "disarmed")

  defp unit(nil, _unit), do: nil
  defp unit(number, unit), do: "#{Columns.cell(number)} #{unit}"

  defp percent(nil), do: nil
  defp percent(share), do: "#{round(share * 100)}%"

  defp condition(condition) do
    subject = if condition["id"], do: "#{condition["subject"]} #{condition["id"]}: ", else: ""

    [
      "\n#{condition["severity"]}: #{Columns.cell(subject <> condition["title"])}\n",
      for(line <- condition["evidence"], do: "  #{Columns.cell(line)}\n"),
      "  to mend it: #{Columns.cell(condition["mend"])}\n"
    ]
  end
end
