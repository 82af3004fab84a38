defmodule Aerie.Incident.ValuesTest do
  use ExUnit.Case, async: true

  alias Aerie.Base.Secret
  alias Aerie.Incident.{Commands, Hide, Series, Span}

  @now 1_795_900_000_000_000

  describe "span" do
    test "reads RFC 3339, a time of day, and times before now" do
      assert {:ok, %{from: from, to: @now}} = Span.parse(nil, nil, @now)
      assert @now - from == 900_000_000
      assert {:ok, %{from: from, to: to}} = Span.parse("-2h", "-10m", @now)
      assert {@now - from, @now - to} == {7_200_000_000, 600_000_000}
      assert {:ok, %{from: from}} = Span.parse(Span.text(@now - 60_000_000), nil, @now)
      assert from == @now - 60_000_000
      assert {:ok, %{from: ^from}} = Span.parse(offset(from), nil, @now)
    end

    test "a time of day that is still to come was yesterday" do
      day = 86_400_000_000
      midnight = @now - Integer.mod(@now, day)
      noon = midnight + div(day, 2)
      assert {:ok, %{from: from}} = Span.parse("11:59", nil, noon)
      assert noon - from == 60_000_000
      assert {:ok, %{from: from}} = Span.parse("12:00:01", nil, noon)
      assert from == noon + 1_000_000 - day
      # Of the day of the end, whatever the time is now.
      to = noon - 3 * day

      for now <- [noon, noon + div(day, 3), noon - div(day, 3)] do
        assert {:ok, %{from: from, to: ^to}} = Span.parse("11:45", Span.text(to), now)
        assert to - from == 900_000_000
      end
    end

    test "what is not a time, or not a span, is refused with what was expected" do
      for {from, to, expected} <- [
            {"yesterday", nil, "--from: 'yesterday': expected RFC 3339"},
            {nil, "25:00", "--to: '25:00': expected"},
            {"-10x", nil, "expected"},
            {"", nil, "expected"},
            {"-999999d", nil, "more than seven days"},
            {"-1m", "-2m", "is not before"},
            {"9999-01-01T00:00:00Z", nil, "not between 1970 and 2100"},
            {"2099-01-01T00:00:00Z", "2099-01-01T01:00:00Z", "in the future"}
          ] do
        assert {:error, text} = Span.parse(from, to, @now)
        assert text =~ expected, "#{from} #{to}: #{text}"
      end
    end
  end

  # The same time, three hours east.
  defp offset(at), do: String.replace(Span.text(at + 3 * 3_600_000_000), "Z", "+03:00")

  describe "series" do
    test "a huge one keeps its peaks, in order, and little of the rest" do
      span = %Span{from: 0, to: 86_400_000_000}
      peaks = %{12_345 => 1.0e6, 400_000 => -1.0e6, 0 => 7, 863_999 => 9}

      points =
        0..863_999
        |> Enum.reduce(Series.new(span), &Series.push(&2, &1 * 100_000, Map.get(peaks, &1, rem(&1, 10))))
        |> Series.points()

      assert length(points) <= 4 * 601
      for {n, value} <- peaks, do: assert({n * 100_000, value} in points)
      assert points == Enum.sort(points)
    end

    test "what is not a number, or before the span, is left out" do
      series = Series.new(%Span{from: 10, to: 20})
      for {at, value} <- [{11, nil}, {11, :nan}, {9, 1}], do: assert(Series.push(series, at, value) == series)
      assert series |> Series.push(15, 3) |> Series.points() == [{15, 3}]
    end
  end

  describe "secrets" do
    test "those of a configuration are hidden wherever they are, others by their names, passwords of URLs" do
      config = %{a: [%{key: Secret.new("hunter2-hunter2")}], b: {Secret.new("short")}, c: nil}
      secrets = Hide.secrets(config)
      assert secrets == ["hunter2-hunter2"]

      hidden =
        Hide.plain(
          %{
            "text" => "it says hunter2-hunter2.",
            "deep" => [%{"hunter2-hunter2" => "x"}],
            "url" => "nats://ann:open@example.org:4222",
            "wifi_password" => "abc",
            "API_KEY" => "abc",
            "pin" => "1234",
            "token" => "t",
            "key_count" => 3,
            "mode" => "LOITER"
          },
          secrets
        )

      text = JSON.encode!(hidden)
      for word <- ~w(hunter2 open abc 1234), do: refute(text =~ word, word)
      assert %{"mode" => "LOITER", "key_count" => 3, "url" => "nats://(hidden)@example.org:4222"} = hidden
    end

    test "frames with a password, a key or a PIN are those that routers and recorders know" do
      for %module{} = message <- MavCodec.SecretSamples.all(),
          module != MavCodec.Messages.SetupSigning,
          do: assert(Hide.frame?(frame(message)), module.name())

      refute Hide.frame?(frame(%MavCodec.Messages.SetupSigning{secret_key: "key"}))
      refute Hide.frame?(frame(%MavCodec.Messages.Attitude{}))
    end

    defp frame(message), do: MavCodec.Frame.from_bytes(MavCodec.encode(message, system: 1), nil)
  end

  describe "commands" do
    @span %Span{from: @now, to: @now + 60_000_000}

    defp record(at, fields), do: %{at: at, fields: Map.put_new(fields, "vehicle", "VID-007"), line: ""}

    test "audit log and ledger of one id are one row; the ledger's missing envelope is filled from the log" do
      audit = [
        record(@now + 1, %{
          "type" => "decision",
          "id" => "a",
          "command" => "hold",
          "decision" => "allow",
          "source" => "ann",
          "params" => %{}
        }),
        record(@now + 9, %{
          "type" => "result",
          "id" => "a",
          "command" => "hold",
          "result" => "completed",
          "reason" => nil
        })
      ]

      ledger = %{
        "a" => %{
          "envelope" => nil,
          "received_at" => @now,
          "sent_at" => @now + 2,
          "result" => "completed",
          "done_at" => @now + 8
        }
      }

      assert [row] = Commands.join(audit, ledger, "VID-007", @span)

      assert %{
               "id" => "a",
               "type" => "hold",
               "decision" => "allow",
               "source" => "ann",
               "result" => "completed"
             } = row

      assert {row["received_at"], row["sent_at"]} == {@now, @now + 2}
      assert %{"sent_at" => "20" <> _} = Commands.plain(row)
    end

    test "refused MAVLink has a row of its own; other vehicles and other times have none" do
      audit = [
        record(@now + 5, %{"type" => "decision", "command" => "arm", "decision" => "deny", "rule" => "role"}),
        record(@now + 5, %{
          "type" => "decision",
          "command" => "arm",
          "decision" => "deny",
          "vehicle" => "VID-008"
        }),
        record(@now - 5, %{"type" => "decision", "command" => "land", "decision" => "deny"})
      ]

      other = %{"envelope" => %{"vehicle" => "VID-008", "type" => "rtl"}, "received_at" => @now + 1}

      assert [%{"type" => "arm", "rule" => "role", "vehicle" => "VID-007"}] =
               Commands.join(audit, %{"b" => other}, "VID-007", @span)
    end

    test "a command that began before the span and ended within it is there" do
      audit = [
        record(@now + 5, %{"type" => "result", "id" => "c", "command" => "rtl", "result" => "completed"})
      ]

      early = %{
        "envelope" => %{"vehicle" => "VID-007", "type" => "rtl"},
        "received_at" => @now - 90_000_000,
        "done_at" => @now + 5
      }

      assert [%{"id" => "c"}] = Commands.join(audit, %{"c" => early}, "VID-007", @span)
    end
  end
end
