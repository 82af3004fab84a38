defmodule Aerie.Console.RightsTest do
  @moduledoc "Who may change what: over REST with each kind of key, and in the console, against the one table."
  use Aerie.APICase, async: true

  alias Aerie.Base.Store
  alias Aerie.CommandCase
  alias MavRouter.{Client, Link, Router}
  alias Aerie.Api.Rest.{OpenAPI, Routes}
  alias Aerie.Console
  alias Aerie.Access.Changes.Rights

  @moduletag :tmp_dir
  @json {"content-type", "application/json"}
  @keys for {role, letter} <- [viewer: "v", operator: "o", admin: "a"],
            into: %{},
            do: {role, String.duplicate(letter, 24)}

  defp keyed(dir, options) do
    file = Path.join(dir, "keys")
    File.write!(file, for({role, key} <- @keys, do: "#{role} #{key} role=#{role}\n"))
    File.chmod!(file, 0o600)
    start_server([keys_file: file] ++ options)
  end

  defp ask(port, role, method, path, body \\ %{}) do
    key = if role, do: [{"x-aerie-key", @keys[role]}], else: []
    {status, _headers, answer} = request(port, method, path, [@json | key], JSON.encode!(body))
    {status, answer}
  end

  # One request for each action that changes something, with an id that exists nowhere.
  defp changes do
    for %{method: method, path: path} = route <- Routes.all(),
        method != "GET",
        do: {path |> String.replace(~r/:[a-z]+/, "x") |> String.replace("[...]", "x"), method, route}
  end

  test "what only the console offers, and what nobody listed, is an admin's" do
    for change <- [:restart_link, :make_key, :change_users, :delete_recording, :a_new_one],
        do: assert(Rights.least(change) == :admin)
  end

  test "each change that a route makes is listed" do
    for %{change: change} when change != nil <- Routes.all(), do: assert(is_map_key(Rights.all(), change))
  end

  test "a key changes what its role may, and a higher role what a lower one may", %{tmp_dir: dir} do
    %{port: port} = keyed(dir, links: true)

    # The levels of the log and the policy are the gateway's own: their tests change them.
    for {path, method, route} <- changes(),
        route.change not in [:change_log, :reload_policy],
        role <- Map.keys(@keys) do
      allowed? = Aerie.Control.Policy.Roles.at_least?(role, route.role)
      {status, answer} = ask(port, role, method, path)
      refused? = status == 403 and answer["error"]["message"] =~ ~r/this needs|may only read/
      assert {method, path, role, refused?} == {method, path, role, not allowed?}
    end
  end

  test "links, clients, rules and keys are an admin's: an operator's key leaves everything as it was", %{
    tmp_dir: dir
  } do
    %{gateway: gateway, port: port} = keyed(dir, links: true)
    {:ok, "ro"} = Client.add(gateway, %{url: "tcpin:127.0.0.1:0", id: "ro", role: :read_only})
    {:ok, "udp"} = Link.start(gateway, "udpin:127.0.0.1:0", id: "udp")
    put_vehicle(gateway, "VID-001", 1)

    for {method, path, body} <- [
          {"POST", "/api/clients", %{"url" => "tcpin:0.0.0.0:0", "id" => "mine"}},
          {"POST", "/api/clients", %{"url" => "udpout:192.0.2.1:9999", "id" => "exfil"}},
          {"DELETE", "/api/clients/ro", %{}},
          {"PATCH", "/api/rules/ro", %{"role" => "full"}},
          {"PATCH", "/api/rules/ro", %{"sniffer" => true}},
          {"PATCH", "/api/rules/udp", %{"networks" => ["other"]}},
          {"PATCH", "/api/rules/udp", %{"filter_in" => %{"block_messages" => ["HEARTBEAT"]}}},
          {"PATCH", "/api/rules/udp", %{"served" => false}},
          {"PATCH", "/api/rules/udp", %{"carry" => %{}}},
          {"PATCH", "/api/rules/udp", %{"id_offsets" => %{"1" => 7}}},
          {"DELETE", "/api/rules/udp", %{}},
          {"POST", "/api/links", %{"url" => "udpin:127.0.0.1:0", "id" => "mine"}},
          {"DELETE", "/api/links/udp", %{}},
          {"PUT", "/api/links/udp/recording", %{"mode" => "off"}},
          {"PUT", "/api/vehicles/VID-001/recording", %{"mode" => "off"}},
          {"POST", "/api/vehicles/VID-001/signing", %{"action" => "revoke"}}
        ],
        role <- [:operator, :viewer] do
      assert {{403, %{"error" => %{"code" => "forbidden"}}}, _path} =
               {ask(port, role, method, path, body), path}
    end

    assert [%{id: "ro", spec: %{options: options}}] = Client.endpoints(gateway)
    assert options[:router][:role] == :read_only
    assert Store.link(gateway, "udp") != nil
    assert Router.changes(gateway) == %{}

    assert {201, _answer} =
             ask(port, :admin, "POST", "/api/clients", %{"url" => "tcpin:127.0.0.1:0", "id" => "mine"})
  end

  test "without a key nobody is an admin: the answer says how to make one, and what a program may still do" do
    %{gateway: gateway, port: port} = start_server(links: true)

    for {path, method, %{role: :admin}} <- changes() do
      assert {{403, %{"error" => %{"message" => words}}}, _path} = {ask(port, nil, method, path), path}
      assert words =~ "console" and words =~ "api.keys_file" and words =~ "X-Aerie-Key"
    end

    assert Client.endpoints(gateway) == [] and Store.links(gateway) == []
    assert {201, %{"ticket" => _}} = ask(port, nil, "POST", "/api/tickets")
    assert {404, _answer} = ask(port, nil, "POST", "/api/vehicles/x/save")
  end

  test "what an admin changes over REST stands in the audit log", %{tmp_dir: dir} do
    %{gateway: gateway, port: port} = keyed(dir, links: true)
    CommandCase.start_commands(dir, gateway: gateway)

    {201, _answer} =
      ask(port, :admin, "POST", "/api/clients", %{"url" => "tcpin:127.0.0.1:0", "id" => "mine"})

    {204, _answer} = ask(port, :admin, "DELETE", "/api/clients/mine")
    {403, _answer} = ask(port, :operator, "DELETE", "/api/clients/mine")
    {201, _answer} = ask(port, :admin, "POST", "/api/links", %{"url" => "udpin:127.0.0.1:0", "id" => "new"})

    {401, _headers, _answer} =
      request(port, "GET", "/api/status", [{"x-aerie-key", "a wrong key of somebody"}])

    entries =
      eventually(fn ->
        found =
          for %{"type" => "change"} = entry <- CommandCase.audit(dir),
              do: Map.take(entry, ["action", "target", "source", "from", "url"])

        if length(found) >= 3, do: found
      end)

    assert [
             %{"action" => "add_client", "target" => "mine", "url" => "tcpin:" <> _},
             %{"action" => "remove_client", "target" => "mine"},
             %{"action" => "add_link", "target" => "new", "url" => "udpin:" <> _}
           ] = entries

    for entry <- entries, do: assert(%{"source" => "http:admin", "from" => "127.0.0.1"} = entry)

    eventually(fn ->
      Enum.find(
        CommandCase.audit(dir),
        &match?(%{"type" => "sign_in", "via" => "http", "outcome" => "refused"}, &1)
      )
    end)

    for file <- Path.wildcard(Path.join(dir, "audit/*.jsonl")), do: refute(File.read!(file) =~ "wrong key of")
  end

  test "the description says which role each operation needs" do
    paths = OpenAPI.document().paths

    for %{path: path, method: method, role: role} <- Routes.all() do
      template = path |> String.replace(~r/:([a-z]+)/, "{\\1}") |> String.replace("[...]", "{path}")
      %{summary: words} = paths[template][String.downcase(method)]

      case role do
        :viewer -> refute words =~ "For the role"
        role -> assert words =~ "For the role #{role}"
      end
    end
  end

  test "the events of the console's pages have the roles of the same table" do
    for {page, event, change} <- [
          {Console.Pages.Links.Page, "add", :add_link},
          {Console.Pages.Links.Page, "remove", :remove_link},
          {Console.Pages.Links.Page, "restart", :restart_link},
          {Console.Pages.Links.Page, "remove-client", :remove_client},
          {Console.Pages.Links.Page, "reset", :reset_rules},
          {Console.Pages.Recordings.Page, "save", :save},
          {Console.Pages.Recordings.Page, "play", :play_recording},
          {Console.Pages.Recordings.Page, "stop", :remove_link},
          {Console.Pages.Recordings.Page, "delete", :delete_recording},
          {Console.Pages.Settings.Page, "add", :change_users},
          {Console.Pages.Settings.Page, "change-role", :change_users},
          {Console.Pages.Settings.Page, "change-password", :change_users},
          {Console.Pages.Settings.Page, "remove", :change_users},
          {Console.Pages.Settings.Page, "add-key", :make_key},
          {Console.Pages.Settings.Page, "revoke-key", :revoke_key}
        ],
        do: assert({page, event, page.__console__().events[event]} == {page, event, Rights.least(change)})
  end
end
