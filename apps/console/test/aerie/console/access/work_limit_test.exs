defmodule Aerie.Console.Access.WorkLimitTest do
  @moduledoc "What costs much is done a few at a time, and refused beyond that."
  use Aerie.ConsoleCase, async: true

  import Aerie.HTTPClient

  alias Aerie.Access.Users
  alias Aerie.Access.WorkLimit

  test "a flood of own-password events costs five hashes; the page says so, and the right one waits as well" do
    [console: console] = start_console()
    {:ok, view, _html} = live(conn(console, :viewer), "/settings")
    wrong = %{"old" => "wrongwrong", "new" => "aaaaaaaaaaaa", "again" => "aaaaaaaaaaaa"}
    for _n <- 1..5, do: assert(render_click(view, "own-password", wrong) =~ "the old password is wrong")
    for _n <- 1..20, do: assert(render_click(view, "own-password", wrong) =~ "too many passwords at once")
    # In another session of the user, too; and another user's is not touched.
    {:ok, other, _html} = live(conn(console, :viewer), "/settings")
    assert render_click(other, "own-password", wrong) =~ "too many passwords at once"
    {:ok, operator, _html} = live(conn(console, :operator), "/settings")
    assert render_click(operator, "own-password", wrong) =~ "the old password is wrong"
    assert Users.find(console.gateway, "viewer") != nil
  end

  test "a flood of events is refused with words, over all pages of a user; then pages are answered with 429" do
    [console: console] = start_console()
    put_vehicle(console, "VID-001")
    views = for _n <- 1..4, do: console |> conn(:viewer) |> live("/") |> elem(1)
    flood = fn view -> for _n <- 1..60, do: render_click(view, "sort", %{"by" => "name"}) end
    assert Enum.any?(Enum.flat_map(views, flood), &(&1 =~ "Too many clicks"))

    # The same user in a browser; and somebody else, who is not held up.
    jar = sign_in(console, "viewer", password(:viewer)).jar

    spend = fn ->
      Stream.repeatedly(fn -> WorkLimit.spend(console.gateway, "viewer", 1) end) |> Enum.find(&(not &1))
    end

    answer =
      eventually(fn ->
        spend.()
        with %{status: 200} <- get(console, "/", jar), do: nil
      end)

    assert answer.status == 429 and answer.body =~ "Too many pages at once"
    assert get(console, "/", sign_in(console, "operator", password(:operator)).jar).status == 200
  end

  test "imports over REST have limits, and say when to ask again" do
    [console: console] =
      start_console(
        config: %{http: %{port: 0}, api: %{key: Aerie.Base.Secret.new("a-key-for-the-tests-0123")}}
      )

    headers = [{"x-aerie-key", "a-key-for-the-tests-0123"}, {"content-type", "application/json"}]

    statuses =
      for _n <- 1..40 do
        {status, head, _body} =
          Aerie.APICase.request(
            console.port,
            "PUT",
            "/api/vehicles/VID-001/mission",
            headers,
            ~s({"plan": {}})
          )

        if status == 429, do: assert(head["retry-after"])
        status
      end

    assert 429 in statuses
    assert Enum.uniq(Enum.take(statuses, 20)) == [422]
  end
end
