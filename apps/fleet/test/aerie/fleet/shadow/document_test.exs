defmodule Aerie.Fleet.Shadow.DocumentTest do
  @moduledoc "Updates and documents: merge by field, versions, expiry, history, bounds, seal."
  use ExUnit.Case, async: true

  import Aerie.ShadowCase, only: [sealed_before: 3]

  alias Aerie.Vehicle.Command.Error
  alias Aerie.Base.Secret
  alias Aerie.Fleet.Shadow.{Document, Update}
  alias Aerie.Fleet.Shadow.Document.{Field, Sealed}
  alias Aerie.Fleet.Shadow.Keys

  @now 1_800_000_000_000_000
  @second 1_000_000
  @author %{actor: "ops", via: "rest"}
  defp key(text \\ "a key of these tests"), do: %Keys{common: Secret.new(text)}

  defp update(desired, more \\ %{}) do
    {:ok, update} = Update.parse(Map.put(more, "desired", desired), @now)
    update
  end

  defp apply!(document, desired, more \\ %{}, now \\ @now) do
    {:ok, document} = Document.apply(document, update(desired, more), @author, now)
    document
  end

  defp values(document, now \\ @now),
    do:
      document |> Document.live(now) |> Map.new(fn {path, entry} -> {path, entry.value} end) |> Field.nested()

  defp errors(object) do
    {:error, errors} = Update.parse(object, @now)
    Enum.map(errors, &Exception.message/1)
  end

  test "Z1: only given fields change, null removes one or a group, the version grows with every update" do
    one = apply!(Document.new("VID-007"), %{"mode" => "LOITER", "params" => %{"A" => 1, "B" => 2}})
    assert values(one) == %{"mode" => "LOITER", "params" => %{"A" => 1.0, "B" => 2.0}}
    two = apply!(one, %{"params" => %{"B" => nil, "C" => 3}})
    assert values(two) == %{"mode" => "LOITER", "params" => %{"A" => 1.0, "C" => 3.0}}
    three = apply!(two, %{"params" => nil, "mode" => nil})
    assert {values(three), three.version} == {%{}, 3}
    assert apply!(three, %{"mode" => nil}).version == 4

    assert [%{removed: ["mode", "params.A", "params.C"]}, %{set: ["params.C"], removed: ["params.B"]}, _first] =
             three.history
  end

  test "Z1: an update for another version is refused, and says which one there is" do
    one = apply!(Document.new("VID-007"), %{"tags" => ["a"]}, %{"version" => 0})

    assert {:error, {:conflict, "the update is for version 0, and the document has version 1"}} =
             Document.apply(one, update(%{"tags" => ["b"]}, %{"version" => 0}), @author, @now)
  end

  test "Z3: each field says who set it, when, why and until when" do
    document =
      apply!(Document.new("VID-007"), %{"mode" => "RTL"}, %{"reason" => "storm", "expires_in_s" => 60})

    expires = @now + 60 * @second

    assert %{
             "mode" => %{
               actor: "ops",
               via: "rest",
               at: @now,
               reason: "storm",
               version: 1,
               expires_at: ^expires
             }
           } =
             document.fields

    assert values(document, expires) == %{}
    later = apply!(document, %{"tags" => ["x"]}, %{}, expires)
    assert Map.keys(later.fields) == ["tags"]
    assert hd(later.history).removed == ["mode"]
  end

  test "a deletion removes all fields and keeps the version" do
    document = apply!(Document.new("VID-007"), %{"mode" => "RTL", "intervals" => %{"ATTITUDE" => 10}})
    {:ok, delete} = Update.parse_delete(%{"reason" => "done"}, @now)
    assert {:ok, %{fields: fields, version: 2}} = Document.apply(document, delete, @author, @now)
    assert fields == %{}
    assert {:error, [%Error{key: "desired"}]} = Update.parse_delete(%{"desired" => %{}}, @now)
  end

  test "bad updates are refused with key, expectation and value" do
    assert errors("x") == [~s(shadow: expected an object, got "x")]
    assert errors(%{}) == ["desired: expected an object with fields, got nothing"]
    assert ["desired.speed: expected only " <> _] = errors(%{"desired" => %{"speed" => 1}})

    assert ["desired.mode: expected a text of 1 to 50 characters, got 7"] =
             errors(%{"desired" => %{"mode" => 7}})

    assert ["desired.armed: expected true or false, got 1"] = errors(%{"desired" => %{"armed" => 1}})
    assert ["desired.signing: expected true, got false"] = errors(%{"desired" => %{"signing" => false}})

    assert ["desired.params.A-B: expected the name" <> _] =
             errors(%{"desired" => %{"params" => %{"A-B" => 1}}})

    assert ["desired.params: expected an object or null, got 3"] = errors(%{"desired" => %{"params" => 3}})

    assert ["desired.intervals.NOPE: expected the name" <> _] =
             errors(%{"desired" => %{"intervals" => %{"NOPE" => 1}}})

    assert ["desired.geofence.on: expected only enabled, plan"] =
             errors(%{"desired" => %{"geofence" => %{"on" => true}}})

    assert ["desired.mission.plan: expected 64 hexadecimal digits" <> _] =
             errors(%{"desired" => %{"mission" => %{"plan" => "x"}}})

    assert ["desired.home.lon: expected a number from -180 to 180 (°), got nothing" | _] =
             errors(%{"desired" => %{"home" => %{"lat" => 1}}})

    wrong = %{
      "desired" => %{"mode" => "X"},
      "version" => -1,
      "expires_in_s" => 0,
      "reason" => String.duplicate("x", 201),
      "more" => 1
    }

    assert length(errors(wrong)) == 4
    both = %{"desired" => %{"mode" => "X"}, "expires_in_s" => 5, "expires_at" => "2027-01-15T08:00:00Z"}
    assert errors(both) == ["expires_at: expected either expires_at or expires_in_s"]
  end

  @page Path.expand("../../../../../../docs/shadow.md", __DIR__)

  test "docs/shadow.md has every field with its permission, and its examples are updates" do
    page = File.read!(@page)

    for field <- Field.all() do
      name =
        String.replace(
          field.name,
          ["params.*", "intervals.*"],
          &if(&1 == "params.*", do: "params.NAME", else: "intervals.MESSAGE")
        )

      assert page =~ ~r/^\| `#{Regex.escape(name)}` \| .* \| `#{field.permission}` \|$/m, name
    end

    examples = for [json] <- Regex.scan(~r/\{"desired": .*\}(?=['`])/, page), do: json |> JSON.decode!()
    assert length(examples) >= 2
    for example <- examples, do: assert({:ok, _update} = Update.parse(example, @now))
  end

  test "everything has a bound" do
    many = for n <- 1..251, into: %{}, do: {"P#{n}", n}

    assert ["desired.params: expected at most 250 fields at once, got 251"] =
             errors(%{"desired" => %{"params" => many}})

    nonsense = for n <- 1..5_000, into: %{}, do: {"nonsense #{n}", n}
    assert length(errors(%{"desired" => nonsense})) == 8

    full = apply!(Document.new("VID-007"), %{"params" => Map.delete(many, "P251")})

    assert {:error, {:limit, "params would have 251" <> _}} =
             Document.apply(full, update(%{"params" => %{"Q" => 1}}), @author, @now)

    long = Enum.reduce(1..100, full, fn n, document -> apply!(document, %{"tags" => ["#{n}"]}) end)
    assert length(long.history) == 20
    assert long.version == 101
    assert byte_size(JSON.encode!(Document.plain(long))) < Document.max_bytes()
  end

  test "a document goes through JSON and back, and only with its seal" do
    document =
      Document.new("VID-007")
      |> apply!(%{
        "mode" => "AUTO",
        "params" => %{"A" => 0.1, "B" => -3.0e38},
        "home" => %{"lat" => 47.1, "lon" => 8, "altitude_msl" => 400}
      })
      |> apply!(%{"tags" => ["ä", "b"], "mission" => %{"plan" => String.duplicate("0a", 32)}}, %{
        "expires_in_s" => 10
      })

    text = Sealed.encode(document, "prod", key())
    assert {:ok, ^document} = Sealed.decode(text, "prod", "VID-007", key())
    assert {:error, "its seal does not fit" <> _} = Sealed.decode(text, "dev", "VID-007", key())

    assert {:error, "its seal does not fit" <> _} =
             Sealed.decode(text, "prod", "VID-007", key("another"))

    assert {:error, "its seal does not fit" <> _} = Sealed.decode(text, "prod", "VID-008", key())

    forged = String.replace(text, "AUTO", "RTL!")
    assert {:error, "its seal does not fit" <> _} = Sealed.decode(forged, "prod", "VID-007", key())

    for junk <- ["", "[]", "{}", ~s({"seal": 1}), <<255>>],
        do: assert({:error, "it has no seal" <> _} = Sealed.decode(junk, "prod", "V", key()))
  end

  test "a companion's key opens and seals its own vehicle's documents and no other one's" do
    common = "the hub's"
    hub = key(common)

    aboard = fn id ->
      %Keys{common: Secret.new("random"), own: %{id => Secret.new(Keys.derive(common, "prod", id))}}
    end

    of = fn id -> apply!(Document.new(id), %{"mode" => "AUTO"}) end

    for {own, other} <- [{"A", "B"}, {"B", "A"}] do
      assert {:ok, _} =
               of.(own)
               |> Sealed.encode("prod", hub)
               |> Sealed.decode("prod", own, aboard.(own))

      assert {:ok, _} =
               of.(own)
               |> Sealed.encode("prod", aboard.(own))
               |> Sealed.decode("prod", own, hub)

      theirs = Sealed.encode(of.(other), "prod", hub)
      assert {:error, "its seal" <> _} = Sealed.decode(theirs, "prod", other, aboard.(own))

      # Whatever is made of what it has: its key in the place of the other's, or of the common one, in the old form too.
      stolen = Secret.new(Keys.derive(common, "prod", own))

      for keys <- [aboard.(own), %Keys{common: stolen}, %Keys{common: stolen, own: %{other => stolen}}],
          seal <- [&Sealed.encode/3, &sealed_before/3] do
        assert {:error, "its seal" <> _} =
                 of.(other) |> seal.("prod", keys) |> Sealed.decode("prod", other, hub)
      end
    end

    refute Keys.derive(common, "prod", "A") == Keys.derive(common, "dev", "A")
    refute Keys.derive(common, "a", "b-c") == Keys.derive(common, "a-b", "c")
  end

  test "documents of earlier versions are read, by the common key of then or the one that is named as the former" do
    document = apply!(Document.new("A"), %{"mode" => "AUTO"})
    before = sealed_before(document, "prod", key("old"))
    assert {:former, %{version: 1}} = Sealed.decode(before, "prod", "A", key("old"))
    assert {:error, "its seal" <> _} = Sealed.decode(before, "prod", "A", key("new"))
    both = %{key("new") | former: Secret.new("old")}
    assert {:former, %{version: 1}} = Sealed.decode(before, "prod", "A", both)
    # The former key seals nothing of today.
    today = Sealed.encode(document, "prod", key("old"))
    assert {:error, "its seal" <> _} = Sealed.decode(today, "prod", "A", both)
  end

  test "whatever JSON comes, an update is taken or refused, and never raises" do
    property =
      :proper.forall(json(), fn value ->
        for object <- [
              value,
              %{"desired" => value},
              %{"desired" => %{"params" => value, "home" => value, "mode" => value}}
            ] do
          match?({:ok, %Update{}}, Update.parse(object, @now)) or
            match?({:error, [_ | _]}, Update.parse(object, @now))
        end
        |> Enum.all?()
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 200]) == true, inspect(:proper.counterexample())
  end

  defp json do
    leaf =
      :proper_types.oneof([
        :proper_types.integer(),
        :proper_types.float(),
        :proper_types.binary(),
        true,
        nil,
        []
      ])

    key = :proper_types.oneof([:proper_types.binary(), "mode", "params", "A", "lat", "enabled", "version"])

    pairs =
      :proper_types.list(
        :proper_types.tuple([key, :proper_types.oneof([leaf, %{"A" => 1}, %{"lat" => "x"}])])
      )

    :proper_types.oneof([leaf, :proper_types.bind(pairs, &Map.new/1, false)])
  end
end
