defmodule Aerie.System.MonitoringTest do
  @moduledoc "Dashboard and alert rules name only metrics and labels that a running gateway has; docs/metrics.md names its labels."

  use Aerie.SystemCase, async: true

  alias Aerie.Api.Metrics
  alias Aerie.Api.Metrics.Page

  @moduletag :tmp_dir
  @moduletag :capture_log
  @folder Path.expand("../../rel/overlays/monitoring", __DIR__)
  # Prometheus' own.
  @foreign %{"up" => ["job", "instance"]}
  @scraped ["instance", "job"]

  defp fly(dir) do
    %{gateway: gateway} = start_gateway(dir, links: ["udpin:127.0.0.1:0"])
    sim = [link: "udpout:127.0.0.1:#{link_port(gateway, "link-1")}"]
    start_supervised!({SimVehicle, sim ++ fast_vehicle(:px4)})
    await_standing(gateway)

    eventually(
      fn -> data(gateway, :battery)[:remaining] && data(gateway, :gps)[:satellites] end,
      "its state is known"
    )

    gateway
  end

  test "what is named exists, with these labels", %{tmp_dir: dir} do
    gateway = fly(dir)
    families = Map.new(Metrics.families(gateway), fn {name, _type, _help, samples} -> {name, samples} end)

    # The labels of the page are those of the samples.
    for {name, samples} <- families, sample <- samples do
      labels = if tuple_size(sample) == 3, do: Keyword.delete(elem(sample, 1), :le), else: elem(sample, 0)
      assert Enum.sort(Keyword.keys(labels)) == Enum.sort(Page.labels(name)), name
    end

    known = for {name, _type, _help} <- Page.known(), into: MapSet.new(), do: name
    assert MapSet.new(Map.keys(families)) == known

    expressions = rules() ++ panels()
    assert length(expressions) > 40

    for expression <- expressions, {name, labels} <- names(expression) do
      family = String.replace(name, ~r/_(bucket|sum|count)\z/, "")
      allowed = @foreign[name] || Enum.map(Page.labels(family), &to_string/1) ++ @scraped ++ le(name)
      assert is_map_key(@foreign, name) or family in known, "#{name} does not exist: #{expression}"
      assert labels -- allowed == [], "#{name} has no such labels: #{expression}"
    end

    # What the dashboard shows of any fleet has values now.
    for {name, _labels} <- Enum.flat_map(panels(), &names/1), always?(name) do
      assert families[name] != [], "#{name} has no sample"
    end
  end

  # Not those that only count what has not happened here.
  defp always?(name),
    do: name =~ ~r/\Agateway_(vehicle|link|vm|nats_connected|nats_ready|outbox|events|mavlink)/

  defp le(name), do: if(String.ends_with?(name, "_bucket"), do: ["le"], else: [])

  defp rules do
    {:ok, rules} = @folder |> Path.join("aerie.rules.yml") |> File.read!() |> Aerie.Config.Yaml.parse()

    for %{"rules" => rules} <- rules["groups"], rule <- rules do
      # An alert without words, or without what to do, helps nobody.
      assert %{
               "alert" => _,
               "labels" => %{"severity" => severity},
               "annotations" => %{"summary" => _, "look_at" => _}
             } = rule

      assert severity in ["warning", "critical"]
      rule["expr"]
    end
  end

  defp panels do
    dashboard = @folder |> Path.join("aerie-dashboard.json") |> File.read!() |> JSON.decode!()
    for %{"targets" => targets} <- dashboard["panels"], target <- targets, do: target["expr"]
  end

  # The metrics of an expression, each with the labels that it is selected by.
  defp names(expression) do
    for [_all, name | selector] <- Regex.scan(~r/\b(gateway_[a-z_]+|up)\b(?:\{([^}]*)\})?/, expression) do
      labels = Regex.scan(~r/([a-z_]+)\s*=~?/, Enum.join(selector)) |> Enum.map(&List.last/1)
      {name, labels}
    end
  end
end
