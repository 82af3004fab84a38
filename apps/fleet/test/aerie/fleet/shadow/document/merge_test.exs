defmodule Aerie.Fleet.Shadow.Document.MergeTest do
  @moduledoc "One document from that aboard and that of the hub, whatever was changed where during a cut."
  use ExUnit.Case, async: true

  alias Aerie.Fleet.Shadow.{Document, Update}
  alias Aerie.Fleet.Shadow.Document.Merge

  @now 1_800_000_000_000_000

  defp changed(document, desired, actor \\ "ops", at \\ @now) do
    {:ok, update} = Update.parse(%{"desired" => desired}, at)
    {:ok, document} = Document.apply(document, update, %{actor: actor, via: "rest"}, at)
    document
  end

  defp values(document), do: Map.new(document.fields, fn {path, entry} -> {path, entry.value} end)
  defp merge(base, aboard, hub), do: Merge.merge(base, aboard, hub, @now)

  setup do
    %{none: Document.new("V"), base: changed(Document.new("V"), %{"mode" => "LOITER", "tags" => ["a"]})}
  end

  test "a side without changes takes the other's document as it is, whatever the clocks say", %{
    base: base,
    none: none
  } do
    other = base |> changed(%{"mode" => "RTL"}, "hub", 1) |> changed(%{"tags" => nil}, "hub", 2)
    assert merge(base, base, other) == other
    assert merge(base, other, base) == other
    assert merge(base, other, other) == other
    assert merge(none, base, none) == base
    assert merge(none, none, base) == base
  end

  test "different fields: both changes, removals too; one field: the hub's, and it says so", %{base: base} do
    aboard = changed(base, %{"mode" => "RTL", "params" => %{"A" => 1}}, "aboard", @now + 9_000_000)

    hub =
      base |> changed(%{"mode" => "LAND"}, "hub") |> changed(%{"tags" => nil, "params" => %{"B" => 2}}, "hub")

    merged = merge(base, aboard, hub)
    assert values(merged) == %{"mode" => "LAND", "params.A" => 1.0, "params.B" => 2.0}
    assert merged.version == hub.version + 1

    assert [
             %{actor: "shadow", set: ["mode"], reason: "changed aboard and at the hub: the hub's" <> _}
             | _before
           ] =
             merged.history

    assert Enum.map(merged.history, & &1.actor) -- ["shadow", "aboard", "hub", "hub", "ops"] == []
    # Both sides have it now, so nothing more happens.
    assert merge(aboard, aboard, merged) == merged
    assert merge(merged, merged, merged) == merged
  end

  test "the history says who changed something, and nothing where nobody did", %{base: base, none: none} do
    reason = fn base, aboard, hub ->
      merged = merge(base, aboard, hub)
      if merged in [aboard, hub], do: :as_it_is, else: hd(merged.history).reason
    end

    # The same wish on both sides, the second one told twice; also when the common document is lost.
    aboard = changed(base, %{"mode" => "RTL"})
    hub = base |> changed(%{"mode" => "LAND"}) |> changed(%{"mode" => "RTL"})
    hub = %{hub | fields: aboard.fields}
    for common <- [base, none], do: assert(reason.(common, aboard, hub) == :as_it_is)
    assert merge(base, aboard, hub) == hub
    # Only the version of one side went on.
    assert reason.(base, base, %{base | version: 7}) == :as_it_is

    # The common document is lost, and one side has more.
    more = changed(base, %{"params" => %{"A" => 1}})
    assert reason.(none, base, more) == "changed at the hub"
    assert reason.(none, more, base) == "changed aboard"

    assert reason.(base, changed(base, %{"params" => %{"A" => 1}}), changed(base, %{"params" => %{"B" => 1}})) ==
             "changed aboard and at the hub, in different fields"

    # What the hub may not change was not changed by anybody.
    merged = Merge.merge(base, base, %{base | version: 9}, @now, ["mode"])
    assert [%{reason: "refused aboard" <> _, removed: ["mode"]} | before] = merged.history
    assert before == base.history
  end

  test "only what the hub may not change stays as it is aboard; to desire what is aboard already changes nothing",
       %{base: base} do
    may? = fn path, _value -> path == "mode" end
    aboard = changed(base, %{"params" => %{"A" => 1}}, "aboard")

    hub =
      base
      |> changed(%{"mode" => "LAND", "params" => %{"B" => 2}}, "hub")
      |> changed(%{"tags" => nil}, "hub")

    assert {permitted, ["params.B", "tags"]} = Merge.permitted(base, aboard, hub, may?)
    assert values(permitted) == %{"mode" => "LAND", "tags" => ["a"]}
    merged = Merge.merge(base, aboard, permitted, @now, ["params.B", "tags"])
    assert values(merged) == %{"mode" => "LAND", "tags" => ["a"], "params.A" => 1.0}
    assert merged.version > max(hub.version, aboard.version)

    assert Enum.any?(
             merged.history,
             &match?(%{actor: "shadow", removed: ["params.B", "tags"], reason: "refused aboard" <> _}, &1)
           )

    # Both sides have it then, and nothing is refused any more, also without the common document.
    assert {^merged, []} = Merge.permitted(merged, merged, merged, may?)
    assert {^merged, []} = Merge.permitted(Document.new("V"), merged, merged, fn _path, _value -> false end)
    assert {^hub, []} = Merge.permitted(base, aboard, hub, fn _path, _value -> true end)
  end

  test "a removal on one side and a change on the other: the hub's counts", %{base: base} do
    removed = changed(base, %{"mode" => nil})
    set = changed(base, %{"mode" => "RTL"})
    refute is_map_key(merge(base, set, removed).fields, "mode")
    assert values(merge(base, removed, set))["mode"] == "RTL"
  end

  test "a document that somebody put back is older than the common one, and counts as unchanged", %{
    base: base,
    none: none
  } do
    common = changed(base, %{"mode" => "RTL"})
    assert merge(common, common, base) == common
    assert merge(common, base, common) == common
    assert merge(common, common, none) == common
    newer = changed(common, %{"tags" => ["b"]})
    assert merge(common, newer, base) == newer
  end

  test "more than a document holds: the hub's", %{none: none} do
    params = fn from -> %{"params" => Map.new(from..(from + 199), &{"P#{&1}", &1})} end
    hub = changed(none, params.(1000))
    merged = merge(none, changed(none, params.(2000)), hub)
    assert values(merged) == values(hub)
    assert merged.version == 2
  end

  # Changes on both sides, with cuts between; after the last exchange both have the same, and it stays so.
  test "both sides agree after any changes and exchanges, and no change of the hub's is lost" do
    for seed <- 1..200 do
      :rand.seed(:exsss, {seed, 1, 1})
      none = Document.new("V")

      {base, aboard, hub} =
        Enum.reduce(1..12, {none, none, none}, fn n, {base, aboard, hub} ->
          change = %{"params" => %{"P#{:rand.uniform(3)}" => if(:rand.uniform(4) > 1, do: n)}}

          case :rand.uniform(3) do
            1 -> {base, changed(aboard, change, "aboard"), hub}
            2 -> {base, aboard, changed(hub, change, "hub")}
            3 -> merge(base, aboard, hub) |> then(&{&1, &1, &1})
          end
        end)

      merged = merge(base, aboard, hub)
      assert merge(merged, merged, merged) == merged
      # The way up worked, the way back did not.
      assert Merge.same?(merge(aboard, aboard, merged), merged)

      changed_at_hub =
        for path <- ~w(params.P1 params.P2 params.P3), hub.fields[path] != base.fields[path], do: path

      for path <- changed_at_hub, do: assert(merged.fields[path] == hub.fields[path])
    end
  end
end
