defmodule Aerie.Vehicle.Command.Page do
  @moduledoc """
  The tables of `docs/commands.md`, made from `Aerie.Vehicle.Command.Types`, `Result` and `Refusal`. They are between
  `<!-- NAME -->` and `<!-- /NAME -->`; the prose around them is written by hand.
  """

  alias Aerie.Base.Json
  alias Aerie.Vehicle.Command.{Param, Refusal, Result, Type, Types}

  @groups [
    flight: "Flight",
    navigation: "Navigation",
    mission: "Mission",
    payload: "Payload",
    manual: "Manual control and set-points",
    maintenance: "Maintenance",
    telemetry: "Messages",
    control: "Who is in charge"
  ]

  @doc "The sections by their names."
  @spec sections() :: %{String.t() => String.t()}
  def sections, do: %{"commands" => commands(), "results" => results(), "refusals" => refusals()}

  @doc "A page with its sections renewed; the others stay as they are."
  @spec renew(String.t(), %{String.t() => String.t()}) :: String.t()
  def renew(page, sections) do
    Enum.reduce(sections, page, fn {name, text}, page ->
      [before, rest] = String.split(page, "<!-- #{name} -->\n", parts: 2)
      [_old, behind] = String.split(rest, "<!-- /#{name} -->", parts: 2)
      before <> "<!-- #{name} -->\n" <> text <> "<!-- /#{name} -->" <> behind
    end)
  end

  defp commands do
    Enum.map_join(@groups, "\n", fn {group, title} ->
      types = Enum.filter(Types.all(), &(&1.group == group))
      "### #{title}\n\n" <> overview(types) <> Enum.map_join(types, &parameters/1)
    end)
  end

  defp overview(types) do
    table(
      ["command", "meaning", "permission", "repeated", "moves it", "done when"],
      for type <- types do
        [
          "`#{type.name}`",
          type.meaning,
          "`#{type.permission}`",
          if(type.retry == :safe, do: "yes", else: "never"),
          if(type.moves_vehicle?, do: "yes", else: "no"),
          type.confirmed_by || "the vehicle accepted it"
        ]
      end
    )
  end

  defp parameters(%{params: []}), do: ""

  defp parameters(type) do
    rules = Enum.map_join(type.rules, &(" Give " <> Type.rule_text(&1) <> "."))

    "\n`#{type.name}`:#{rules}\n\n" <>
      table(
        ["parameter", "is", "default", "meaning"],
        for param <- type.params do
          ["`#{param.name}`", Param.expected(param), default(param), param.meaning]
        end
      )
  end

  defp default(%{required: true}), do: "must be given"
  defp default(%{default: nil}), do: ""
  defp default(%{default: value}) when is_number(value), do: Json.number(value)
  defp default(%{default: value}), do: "#{value}"

  defp results do
    table(
      ["result", "means", "may the vehicle have done it?"],
      for {status, meaning, maybe?} <- Result.table() do
        ["`#{status}`", meaning, if(maybe?, do: "yes", else: "no")]
      end
    )
  end

  defp refusals do
    table(
      ["rule", "said by", "HTTP", "means", "what to do"],
      for row <- Refusal.table() do
        ["`#{row.rule}`", row.by, if(row.http, do: "#{row.http}", else: "of the result"), row.means, row.fix]
      end
    )
  end

  @doc "A table in Markdown."
  @spec table([String.t()], [[String.t()]]) :: String.t()
  def table(head, rows) do
    Enum.map_join([head, Enum.map(head, fn _cell -> "---" end) | rows], &row/1)
  end

  defp row(["---" | _more] = cells), do: "|" <> Enum.map_join(cells, &(&1 <> "|")) <> "\n"

  defp row(cells),
    do: "|" <> Enum.map_join(cells, &(" " <> String.replace(&1, "|", "\\|") <> " |")) <> "\n"
end
