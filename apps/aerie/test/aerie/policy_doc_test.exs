defmodule Aerie.PolicyDocTest do
  @moduledoc "The examples of docs/policy.md: the configuration is loaded, and each decision is the one that the page gives."

  use ExUnit.Case, async: true

  alias Aerie.Config
  alias Aerie.Control.Policy
  alias Aerie.Vehicle.Command
  alias Aerie.Control.Policy.Intent.Context

  @moduletag :tmp_dir
  @page Path.expand("../../../../docs/policy.md", __DIR__)
  @external_resource @page

  defp block(mark) do
    [_all, text] = Regex.run(~r/<!-- #{mark} -->\n```\w+\n(.*?)```/s, File.read!(@page))
    text
  end

  defp rows do
    [_all, table] = Regex.run(~r/<!-- decisions -->\n\|.*?\n\|.*?\n(.*?)\n\n/s, File.read!(@page))

    for line <- String.split(table, "\n") do
      [_all, command, decision] = Regex.run(~r/\A\| `(.*)` \| (.*) \|\z/, line)
      {JSON.decode!(command), decision}
    end
  end

  test "every decision of the page", %{tmp_dir: dir} do
    File.write!(Path.join(dir, "fence.geojson"), block("fence"))
    file = Path.join(dir, "gateway.yaml")
    File.write!(file, String.replace(block("policy"), "fence.geojson", Path.join(dir, "fence.geojson")))
    assert {:ok, config} = Config.load(file, [], env: %{})
    assert config.warnings == []
    assert {:ok, policy} = Policy.compile(config.policy)

    operator = %{name: "operator", role: :operator, permissions: []}
    assert {:ok, %{now: now} = context} = "vehicle" |> block() |> JSON.decode!() |> Context.parse(operator, 0)

    for {given, expected} <- rows() do
      {:ok, command} =
        Command.parse(Map.merge(given, %{"id" => "a", "vehicle" => "VID-001", "source" => "operator"}), now)

      decision =
        case Policy.decide(policy, command, context) do
          :allow -> "allow"
          {:deny, rule, reason} -> "#{rule}: #{reason}"
        end

      assert {given, decision} == {given, expected}
    end
  end

  test "the clients of the page have their roles", %{tmp_dir: dir} do
    {:ok, %{policy: section}} =
      Config.load(write(dir, String.replace(block("policy"), ~r/  geofence_file.*\n/, "")), [], env: %{})

    {:ok, policy} = Policy.compile(section)

    path = %{
      owner: "field-laptop",
      text: "10.0.0.9:5000",
      principal: nil,
      side: :client,
      auto: false,
      commands: true,
      local: false
    }

    assert %{name: "field-laptop", role: :operator, permissions: [:force_disarm]} =
             Policy.principal(policy, path)

    assert %{role: :viewer} = Policy.principal(policy, %{path | owner: "another"})
    {:ok, open} = Policy.compile(%{})
    assert %{role: :viewer} = Policy.principal(open, path)
    assert %{role: :operator} = Policy.principal(open, %{path | local: true})
  end

  defp write(dir, text) do
    file = Path.join(dir, "other.yaml")
    File.write!(file, text)
    file
  end
end
