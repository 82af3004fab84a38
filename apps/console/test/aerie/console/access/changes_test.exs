defmodule Aerie.Console.Access.ChangesTest do
  @moduledoc "Nothing of the gateway is changed without a record of who, from where, and what; no secret is in it."
  use Aerie.ConsoleCase, async: true

  import Aerie.HTTPClient

  alias Aerie.Control.Policy.Audit
  alias Aerie.Api.Rest.Routes
  alias Aerie.Access.Changes
  alias Aerie.Access.Sessions

  @moduletag :tmp_dir
  @lib Path.expand("../../../../lib/aerie", __DIR__)

  setup %{tmp_dir: dir} do
    [console: console] = start_console()
    start_supervised!({Audit, gateway: console.gateway, dir: Path.join(dir, "audit"), max_bytes: 8_000_000})
    {:ok, console: console}
  end

  defp records(dir, type), do: for(%{"type" => ^type} = record <- Aerie.CommandCase.audit(dir), do: record)
  defp text(dir), do: dir |> Path.join("audit/*.jsonl") |> Path.wildcard() |> Enum.map_join(&File.read!/1)

  defp recorded(dir, type, n) do
    eventually(fn ->
      records = records(dir, type)
      if length(records) >= n, do: records
    end)
  end

  test "sign-ins, good and failed, and sign-outs, with the address; what was typed in vain is not kept", %{
    console: console,
    tmp_dir: dir
  } do
    reads =
      [:child_spec, :start_link, :owner, :file, :init, :handle_call, :handle_info, :code_change, :handle_cast] ++
        [:terminate]

    # Both are called by the handler alone, which records them.
    assert names(Sessions) -- reads == [:finish, :open]

    signed = sign_in(console, "operator", password(:operator))
    home = get(console, "/", signed.jar)
    post(console, "/sign-out", home.jar, %{"_csrf_token" => csrf(home.body)})
    assert sign_in(console, "admin", "not-the-password").status == 403
    assert sign_in(console, "typed-a-password-here", "x").status == 403

    assert [
             %{"outcome" => "signed_in", "source" => "operator", "from" => "127.0.0.1"},
             %{"outcome" => "signed_out", "source" => "operator", "from" => "127.0.0.1"},
             %{"outcome" => "refused", "source" => "admin", "from" => "127.0.0.1"}
           ] = recorded(dir, "sign_in", 3)

    refute text(dir) =~ "not-the-password"
    refute text(dir) =~ "typed-a-password"
    # Those that follow are counted.
    late = System.monotonic_time(:microsecond) + 120_000_000
    assert [%{"count" => 1}] = Audit.Refusals.due(console.gateway, late)
  end

  test "what /api changes is recorded by its route, unless something else does" do
    changes = for %{change: change} when change != nil <- Routes.all(), do: change
    assert Enum.sort(Enum.reject(changes, &Changes.recorded?/1)) == Enum.sort(Changes.recorded_elsewhere())
    for %{method: "GET", change: change} <- Routes.all(), do: assert(change == nil)

    # Those of an operation are recorded by the policy.
    for %{method: method, change: nil, action: action} when method != "GET" <- Routes.all(),
        do: assert({:operation, _choices} = action)

    # A new one is recorded without anybody thinking of it.
    assert Changes.recorded?(:a_new_one) and not Changes.recorded?(nil)
    for change <- [:add_link, :change_rules, :change_log, :save, :sign_vehicle], do: assert(change in changes)
  end

  # The functions by which pages change something of the gateway, and where each is recorded.
  @writes ~w(Link.start Link.stop Link.restart Client.add Client.remove Router.reset Router.change Recorder.start
             Recorder.stop Recorder.save Recorder.delete Log.set_level Enrolment.enrol Enrolment.revoke
             Enrolment.discard Policy.Store.reload)

  test "each event of a page that changes links, clients, recordings or settings writes a record" do
    pages = Path.wildcard(Path.join(@lib, "console/**/*.ex"))

    clauses =
      for page <- pages,
          clause <- page |> File.read!() |> String.split(~r/^  (?=defp? )/m) |> Enum.drop(1),
          write <- @writes,
          clause =~ ~r/\b#{Regex.escape(write)}\(/,
          do: {Path.relative_to(page, @lib), clause |> String.split("\n") |> hd(), clause}

    assert length(clauses) >= 7

    for {page, head, clause} <- clauses, not String.starts_with?(head, "defp add(") do
      assert clause =~ "note(" or clause =~ "answer(", "#{page}: #{head} changes something without a record"
    end
  end

  defp names(module),
    do: module.__info__(:functions) |> Enum.map(&elem(&1, 0)) |> Enum.uniq() |> Enum.sort()
end
