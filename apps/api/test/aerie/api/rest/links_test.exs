defmodule Aerie.Api.Rest.LinksTest do
  use Aerie.APICase, async: true

  alias Aerie.Base.Store

  @json {"content-type", "application/json"}

  test "a link to vehicles is added and removed while the gateway runs" do
    %{gateway: gateway, port: port} = start_server(key: true, links: true)
    admin = {"x-aerie-key", key()}
    add = &request(port, "POST", "/api/links", [@json, admin], JSON.encode!(&1))

    assert {201, _headers, %{"id" => "field"}} =
             add.(%{
               "url" => "udpin:127.0.0.1:0",
               "id" => "field",
               "network" => "north",
               "label" => "the mast"
             })

    assert %{network: "north", status: status} = Store.link(gateway, "field")
    assert status in [:up, :idle]

    assert {409, _headers, %{"error" => %{"message" => "there is already a link field"}}} =
             add.(%{"url" => "udpin:127.0.0.1:0", "id" => "field"})

    assert {200, _headers, %{"links" => [%{"id" => "field"}]}} = request(port, "GET", "/api/links", [admin])
    assert {204, _headers, nil} = request(port, "DELETE", "/api/links/field", [admin])
    assert {404, _headers, _body} = request(port, "DELETE", "/api/links/field", [admin])
    assert Store.link(gateway, "field") == nil
  end

  @tag :tmp_dir
  test "an operator's key adds and removes none", %{tmp_dir: dir} do
    key = String.duplicate("o", 24)
    file = Path.join(dir, "keys")
    File.write!(file, "op #{key} role=operator\n")
    File.chmod!(file, 0o600)
    %{gateway: gateway, port: port} = start_server(links: true, keys_file: file)
    {:ok, "radio"} = MavRouter.Link.start(gateway, "udpin:127.0.0.1:0", id: "radio")
    headers = [@json, {"x-aerie-key", key}]
    body = JSON.encode!(%{"url" => "udpin:127.0.0.1:0", "id" => "field"})
    assert {403, _headers, _body} = request(port, "POST", "/api/links", headers, body)
    assert {403, _headers, _body} = request(port, "DELETE", "/api/links/radio", headers)
    assert {403, _headers, _body} = request(port, "POST", "/api/config/reload", headers, "{}")
    assert [%{id: "radio"}] = Store.links(gateway)
  end

  test "a wrong request says what is expected" do
    %{gateway: gateway, port: port} = start_server(links: true, key: true)

    for {body, words} <- [
          {%{}, "url"},
          {%{"url" => 7}, "url"},
          {%{"url" => "replay:/etc/passwd"}, "recording"},
          {%{"url" => String.duplicate("x", 600)}, "url"},
          {%{"url" => "udpin::1", "id" => "a b"}, "letters"},
          {%{"url" => "udpin::1", "network" => 7}, "letters"},
          {%{"url" => "udpin::1", "label" => String.duplicate("x", 300)}, "label"},
          {%{"url" => "udpin::1", "high_latency" => "yes"}, "true or false"},
          {%{"url" => "udpin::1", "sudo" => true}, "sudo: expected only url, id"}
        ] do
      assert {422, _headers, %{"error" => %{"message" => message}}} =
               request(port, "POST", "/api/links", [@json, {"x-aerie-key", key()}], JSON.encode!(body))

      assert message =~ words
    end

    assert Store.links(gateway) == []
  end
end
