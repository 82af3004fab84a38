defmodule Aerie.Api.Rest.TicketsTest do
  use Aerie.APICase, async: true

  alias Aerie.Access.Tickets

  test "POST /api/tickets issues one to the holder of a key" do
    %{gateway: gateway, port: port} = start_server(key: true)
    assert {401, _headers, _body} = request(port, "POST", "/api/tickets")

    assert {201, _headers, %{"ticket" => ticket, "expires_s" => 30}} =
             request(port, "POST", "/api/tickets", [{"x-aerie-key", key()}])

    assert {:ok, %{name: "api.key", role: nil}} = Tickets.redeem(gateway, ticket)
  end
end
