defmodule Aerie.Reload.ChangesTest do
  use ExUnit.Case, async: true

  alias Aerie.Config
  alias Aerie.Reload.Changes

  defp between(old, new), do: Changes.between(Config.default(old), Config.default(new))
  defp ids(entries), do: Map.new(entries, fn {what, list} -> {what, Enum.map(list, & &1.id)} end)

  @links [%{"id" => "a", "url" => "udpin:127.0.0.1:5001"}, %{"id" => "b", "url" => "udpin:127.0.0.1:5002"}]

  test "the same configuration changes nothing, with secrets in it too" do
    given = %{"links" => @links, "api" => %{"key" => "0123456789abcdef"}}
    none = %{added: [], removed: [], changed: []}
    assert between(given, given) == %{links: none, clients: none, log?: false, restart: []}
  end

  test "links and clients by their ids; what is not enabled is not there" do
    new = [
      %{"id" => "b", "url" => "udpin:127.0.0.1:5002", "rate_limits" => %{"ATTITUDE" => 4}},
      %{"id" => "c", "url" => "udpin:127.0.0.1:5003"},
      %{"id" => "d", "url" => "udpin:127.0.0.1:5004", "enabled" => false}
    ]

    changes = between(%{"links" => @links}, %{"links" => new})
    assert ids(changes.links) == %{added: ["c"], removed: ["a"], changed: ["b"]}
    assert changes.restart == []

    client = %{"id" => "gcs", "url" => "udpout:127.0.0.1:14550"}
    changes = between(%{"clients" => []}, %{"clients" => [client]})
    assert ids(changes.clients) == %{added: ["gcs"], removed: [], changed: []}
  end

  test "keys of other parts are named, a secret without its value; the policy and the log are not" do
    changes =
      between(
        %{"api" => %{"key" => "0123456789abcdef"}},
        %{
          "api" => %{"key" => "fedcba9876543210"},
          "http" => %{"port" => 4001},
          "log" => %{"level" => "debug"}
        }
      )

    assert Enum.sort(changes.restart) == ["api.key", "http.port"]
    assert changes.log?
  end

  test "in force is what was started with, and what a reload takes over" do
    start = Config.default(%{"http" => %{"port" => 4001}, "links" => @links})
    later = Config.default(%{"http" => %{"port" => 4002}, "log" => %{"level" => "debug"}})
    now = Changes.in_force(start, later)
    assert now.http.port == 4001
    assert now.log.level == :debug
    assert now.links == later.links
    assert now.given == %{"http.port" => "command line", "log.level" => "command line"}
  end

  test "from the default client to configured ones takes a restart" do
    assert between(%{}, %{"clients" => []}).restart == ["clients"]
  end
end
