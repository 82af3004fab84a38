defmodule Aerie.Api.Rest.LogLevelsTest do
  # The levels belong to the VM.
  use Aerie.APICase, async: false

  @moduletag :tmp_dir
  @admin String.duplicate("a", 24)
  @operator String.duplicate("o", 24)
  @viewer String.duplicate("v", 24)

  defp change(port, key, body) do
    headers = [{"content-type", "application/json"}, {"x-aerie-key", key}]
    request(port, "PATCH", "/api/log", headers, JSON.encode!(body))
  end

  defp port(dir) do
    file = Path.join(dir, "keys")

    File.write!(
      file,
      "boss #{@admin} role=admin\nop #{@operator} role=operator\neye #{@viewer} role=viewer\n"
    )

    File.chmod!(file, 0o600)
    start_server(keys_file: file).port
  end

  test "an admin changes levels while the gateway runs, an operator and a viewer do not", %{tmp_dir: dir} do
    port = port(dir)
    on_exit(fn -> Aerie.Base.Log.reset("gnat") end)

    assert {200, _headers, %{"areas" => areas, "level" => "warning"}} =
             change(port, @admin, %{"areas" => %{"gnat" => "debug"}})

    assert areas == %{"gnat" => "debug"}
    assert Logger.get_module_level(Gnat) == [{Gnat, :debug}]
    assert {403, _headers, _body} = change(port, @operator, %{"level" => "none"})
    assert {403, _headers, _body} = change(port, @viewer, %{"level" => "none"})
    assert Logger.level() == :warning

    assert {200, _headers, %{"areas" => %{"gnat" => "debug"}}} =
             request(port, "GET", "/api/log", [{"x-aerie-key", @viewer}])

    assert {200, _headers, %{"areas" => none}} = change(port, @admin, %{"areas" => %{"gnat" => nil}})
    assert none == %{}
    assert Logger.get_module_level(Gnat) == []
  end

  test "a wrong body changes nothing and says what is expected", %{tmp_dir: dir} do
    port = port(dir)
    before = Aerie.Base.Log.levels()

    for {body, words} <- [
          {%{}, "nothing to change"},
          {%{"level" => "loud"}, "debug, info"},
          {%{"level" => nil}, "nothing to change"},
          {%{"areas" => "gnat"}, "an object"},
          {%{"areas" => %{"gnatt" => "debug"}}, "gnat"},
          {%{"areas" => %{"gnat" => 7}}, "debug, info"},
          {%{"level" => "debug", "areas" => %{"gnat" => 7}}, "debug, info"},
          {%{"colour" => true}, "level"}
        ] do
      assert {422, _headers, %{"error" => %{"message" => message}}} = change(port, @admin, body)
      assert message =~ words
    end

    assert Aerie.Base.Log.levels() == before
  end
end
