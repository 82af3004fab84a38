defmodule Aerie.Fleet.Bridge.Commands.OperationTest do
  @moduledoc "Errors in requests, named before a vehicle is asked; transfer_faces_test.exs flies the rest."
  use Aerie.CommandCase, async: true

  alias Aerie.Control.Operations
  alias Aerie.Fleet.Bridge.Commands.Operation

  @moduletag :tmp_dir
  @ops %{name: "ops", role: :admin, permissions: []}

  setup %{tmp_dir: dir}, do: {:ok, gateway: start_commands(dir)}

  defp ask(gateway, what, request) do
    request = Map.merge(%{"vehicle" => "VID-404", "id" => "t1"}, request)
    Operation.answer(gateway, what, request, @ops, {self(), :progress})
  end

  defp wrong(gateway, what, request) do
    assert %{"result" => "rejected", "rule" => "malformed", "errors" => [%{key: key} | _], "reason" => reason} =
             ask(gateway, what, request)

    assert is_binary(reason)
    key
  end

  test "the areas and their operations", c do
    assert Enum.sort(Operations.areas()) == ["files", "logs", "mission", "params"]
    assert {:ok, %{name: "logs.read"}} = Operations.fetch("logs.read")
    assert Operations.fetch("logs.write") == :error
    assert wrong(c.gateway, "files.format", %{}) == "subject"
  end

  test "what changes a vehicle has an id, so that a copy is the same request", c do
    for what <- ["params.set", "mission.clear", "files.remove"],
        id <- [nil, "", "a b", String.duplicate("x", 65), 7],
        do: assert(wrong(c.gateway, what, %{"id" => id, "path" => "/a"}) == "id")

    # An id of a reader is checked, too, but need not be there.
    assert wrong(c.gateway, "params.get", %{"id" => "a.b", "name" => "N"}) == "id"

    assert %{"id" => <<_made::binary>>, "reason" => "there is no vehicle VID-404"} =
             ask(c.gateway, "params.get", %{"id" => nil, "name" => "N"})
  end

  test "times, kinds, paths, data, pieces and unknown keys", c do
    for timeout <- [0, -1, "5", 1.0e9],
        do: assert(wrong(c.gateway, "logs.list", %{"timeout" => timeout}) == "timeout")

    entry = %{"id" => 1, "size" => 10, "time" => nil}

    for {what, request, key} <- [
          {"params.list", %{"name" => "N"}, "name"},
          {"params.metadata", %{"names" => [1]}, "names[0]"},
          {"params.metadata", %{"names" => "N"}, "names"},
          {"params.load", %{}, "values"},
          {"params.load", %{"values" => %{"N" => 1}, "file" => "N,1"}, "file"},
          {"params.load", %{"values" => %{"N" => 1}, "component" => 1}, "component"},
          {"mission.get", %{"kind" => "plan"}, "kind"},
          {"mission.put", %{"plan" => %{}, "force" => "yes"}, "force"},
          {"files.list", %{}, "path"},
          {"files.read", %{"path" => 1}, "path"},
          {"files.write", %{"path" => "/a", "data" => "not base64!"}, "data"},
          {"files.read", %{"path" => "/a", "data" => ""}, "data"},
          {"logs.read", %{}, "log"},
          {"logs.read", %{"log" => %{entry | "id" => 70_000}}, "log"},
          {"logs.read", %{"log" => entry, "offset" => -1}, "offset"},
          {"logs.read", %{"log" => entry, "bytes" => 1_000_001}, "bytes"}
        ],
        do: assert({what, key} == {what, wrong(c.gateway, what, request)})
  end

  test "refuses what is not a plan with what is wrong in it", c do
    for plan <- [nil, %{}, "text"] do
      assert %{"result" => "rejected", "errors" => [%{key: "plan"}]} =
               ask(c.gateway, "mission.put", %{"plan" => plan})
    end
  end

  test "of a vehicle that is not known each says so", c do
    for {what, request} <- [
          {"params.list", %{}},
          {"params.set", %{"name" => "N", "value" => 1}},
          {"params.load", %{"values" => %{"N" => 1}}},
          {"params.load", %{"file" => "N,1"}},
          {"mission.get", %{"kind" => "fence"}},
          {"mission.clear", %{}},
          {"files.list", %{"path" => "/"}},
          {"files.crc", %{"path" => "/a"}},
          {"files.read", %{"path" => "/a"}},
          {"files.write", %{"path" => "/a", "data" => "AA=="}},
          {"files.remove", %{"path" => "/a"}},
          {"logs.list", %{}},
          {"logs.read", %{"log" => %{"id" => 1, "size" => 10, "time" => 5}}}
        ] do
      assert %{"id" => "t1", "result" => result, "reason" => reason} = ask(c.gateway, what, request)
      assert {what, true} == {what, result in ["rejected", "failed"] and reason =~ "VID-404"}
    end
  end
end
