defmodule Aerie.System.PromtoolTest do
  @moduledoc """
  Prometheus' own tool accepts what a gateway with vehicles answers, the alert rules and every expression of the dashboard. The rules have unit
  tests beside them: each alert in a case where it fires, and in one where it does not.
  """

  use Aerie.SystemCase, async: true

  alias Aerie.Api.Metrics

  @moduletag :tmp_dir
  @moduletag :capture_log
  @moduletag :promtool
  @folder Path.expand("../../rel/overlays/monitoring", __DIR__)
  @rules Path.join(@folder, "aerie.rules.yml")
  @tests Path.join(@folder, "aerie.rules.test.yml")

  test "the metrics of a gateway with vehicles", %{tmp_dir: dir} do
    %{gateway: gateway} = start_gateway(dir, links: ["udpin:127.0.0.1:0", "udpin:127.0.0.1:0"])

    for {firmware, n} <- [px4: 1, ardupilot: 2] do
      options = [link: "udpout:127.0.0.1:#{link_port(gateway, "link-#{n}")}", system: n]
      start_supervised!({SimVehicle, options ++ fast_vehicle(firmware)}, id: firmware)
      await_standing(gateway, {"main", n})
    end

    port = Aerie.Api.Endpoint.port(gateway)
    {:ok, {{_version, 200, _reason}, _headers, page}} = :httpc.request("http://localhost:#{port}/metrics")
    assert length(Regex.scan(~r/^gateway_vehicle_online\{/m, to_string(page))) == 2
    accepts_metrics(dir, page)
  end

  test "the metrics of which a gateway has no value yet", %{tmp_dir: dir} do
    families =
      for {name, type, help} <- Metrics.Page.known() do
        labels = for label <- Metrics.Page.labels(name), do: {label, "x"}
        {name, type, help, samples(type, labels)}
      end

    accepts_metrics(dir, Metrics.Text.render(families))
  end

  test "the rules and the example of a configuration" do
    assert {_output, 0} = promtool(["check", "rules", "--lint=all", "--lint-fatal", @rules])
    assert {_output, 0} = promtool(["check", "config", "--lint=all", Path.join(@folder, "prometheus.yml")])
  end

  test "each alert fires when it should, and not when it should not" do
    assert {_output, 0} = promtool(["test", "rules", @tests])

    # Each has a case of both kinds.
    cases = for %{"alert_rule_test" => cases} <- yaml(@tests)["tests"], alert <- cases, do: alert
    fires = for %{"alertname" => name, "exp_alerts" => [_ | _]} <- cases, uniq: true, do: name
    silent = for %{"alertname" => name} = one <- cases, one["exp_alerts"] in [nil, []], uniq: true, do: name
    alerts = for %{"rules" => rules} <- yaml(@rules)["groups"], %{"alert" => name} <- rules, do: name
    assert alerts -- fires == []
    assert alerts -- silent == []
  end

  test "every expression of the dashboard", %{tmp_dir: dir} do
    dashboard = @folder |> Path.join("aerie-dashboard.json") |> File.read!() |> JSON.decode!()
    expressions = for %{"targets" => targets} <- dashboard["panels"], %{"expr" => expr} <- targets, do: expr
    assert length(expressions) > 20

    rules =
      for {expression, n} <- Enum.with_index(expressions),
          do: %{"record" => "panel:#{n}", "expr" => String.replace(expression, ~r/\$[a-z]+/, ".*")}

    file = Path.join(dir, "dashboard.rules.yml")
    # JSON is YAML.
    File.write!(file, JSON.encode!(%{"groups" => [%{"name" => "dashboard", "rules" => rules}]}))
    assert {output, 0} = promtool(["check", "rules", file])
    assert output =~ "#{length(rules)} rules found"
  end

  defp samples(:histogram, labels) do
    [
      {"_bucket", labels ++ [le: "1"], 1},
      {"_bucket", labels ++ [le: "+Inf"], 1},
      {"_sum", labels, 1},
      {"_count", labels, 1}
    ]
  end

  defp samples(_type, labels), do: [{labels, 1}]

  # It also fails for what is only bad style: a name without a unit, a counter without _total.
  defp accepts_metrics(dir, page) do
    file = Path.join(dir, "metrics")
    File.write!(file, page)
    # It reads from its standard input.
    assert {"", 0} =
             System.cmd("sh", ["-c", "exec promtool check metrics <\"$1\"", "sh", file],
               stderr_to_stdout: true
             )
  end

  defp promtool(words), do: System.cmd("promtool", words, stderr_to_stdout: true)

  defp yaml(file) do
    {:ok, content} = file |> File.read!() |> Aerie.Config.Yaml.parse()
    content
  end
end
