defmodule Aerie.Control.Policy.Roles.SignatureTest do
  use ExUnit.Case, async: true

  alias Aerie.Base.Principal
  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.Roles.Signature
  alias Aerie.Control.Policy.Roles.Sources

  @time ~U[2026-11-22 09:30:00Z]
  @now DateTime.to_unix(@time, :microsecond)
  @subject "fleet.prod.VID-001.cmd.arm"
  @body ~s({"id": "a1", "source": "olga"})

  defp policy(section) do
    {:ok, policy} = Policy.compile(section)
    policy
  end

  test "who is listed and signed rightly is known; the name is the policy's" do
    key = Nkey.generate(:user)

    policy =
      policy(%{sources: [%{name: "olga", nkey: key.public, role: :operator, permissions: [:force_disarm]}]})

    header = Signature.sign(key, @subject, @body, @time)

    assert {:ok, %Principal{kind: :key, name: "olga", role: :operator, permissions: [:force_disarm]}} =
             Sources.identify(policy, header, @subject, @body, @now)
  end

  # Its values were made with NATS's own library for Python.
  test "the example of docs/commands.md" do
    page = File.read!(Path.expand("../../../../../../../docs/commands.md", __DIR__))
    [_all, lines] = Regex.run(~r/<!-- signature -->\n```text\n(.+?)```\n<!-- \/signature -->/s, page)

    shown =
      for line <- String.split(lines, "\n", trim: true),
          [name, text] = String.split(line, ~r/ +/, parts: 2),
          into: %{},
          do: {name, text}

    {:ok, key} = Nkey.from_seed(shown["seed"])
    {:ok, time, 0} = DateTime.from_iso8601(shown["time"])
    assert Base.encode16(key.secret, case: :lower) == shown["secret"]

    assert Signature.sign(key, shown["subject"], shown["body"], time) ==
             "#{shown["key"]} #{shown["time"]} #{shown["signature"]}"

    # The bytes as the page puts them.
    assert page =~ "aerie-command-1\\nSUBJECT\\nTIME\\nBODY"
    bytes = "aerie-command-1\n#{shown["subject"]}\n#{shown["time"]}\n#{shown["body"]}"
    assert shown["signature"] == Base.url_encode64(Nkey.sign(key, bytes), padding: false)
  end

  test "any change of subject, body, time, key or signature is refused" do
    key = Nkey.generate(:user)
    header = Signature.sign(key, @subject, @body, @time)
    [public, at, signature] = String.split(header)
    other = Nkey.generate(:user)
    assert {:ok, ^public} = Signature.verify(header, @subject, @body, @now)

    for {header, subject, body} <- [
          {header, "fleet.prod.VID-002.cmd.arm", @body},
          {header, "fleet.test.VID-001.cmd.arm", @body},
          {header, @subject, @body <> " "},
          {"#{other.public} #{at} #{signature}", @subject, @body},
          {"#{public} 2026-11-22T09:30:01Z #{signature}", @subject, @body},
          {"#{public} #{at} #{Base.url_encode64(:binary.copy(<<0>>, 64), padding: false)}", @subject, @body},
          {"#{public} #{at} #{String.duplicate("A", 86)}", @subject, @body}
        ] do
      assert {:deny, :signature, "the signature does not fit" <> _} =
               Signature.verify(header, subject, body, @now)
    end

    for header <- [
          "",
          "U",
          "#{public} #{at}",
          "#{public} noon #{signature}",
          "#{public} #{at} !!",
          "SUAB #{at} #{signature}",
          String.duplicate("x", 600)
        ] do
      assert {:deny, :signature, "the header Aerie-Signature" <> _} =
               Signature.verify(header, @subject, @body, @now)
    end

    random =
      :proper.forall({:proper_types.binary(), :proper_types.binary()}, fn {header, body} ->
        match?({:deny, :signature, _}, Signature.verify(header, @subject, body, @now))
      end)

    assert :proper.quickcheck(random, [:quiet, numtests: 200]) == true, inspect(:proper.counterexample())
  end

  test "a signature counts for a minute, and not before its time" do
    key = Nkey.generate(:user)
    header = Signature.sign(key, @subject, @body, @time)
    assert {:ok, _key} = Signature.verify(header, @subject, @body, @now + 60_000_000)
    assert {:ok, _key} = Signature.verify(header, @subject, @body, @now - 5_000_000)

    assert Signature.verify(header, @subject, @body, @now + 61_500_000) ==
             {:deny, :signature, "the signature is 61 s old; it counts for 60 s"}

    assert Signature.verify(header, @subject, @body, @now - 6_000_000) ==
             {:deny, :signature, "the signature's time is 6 s ahead of the gateway's clock"}
  end

  test "who is not listed, or not any more, or does not sign, commands nothing; unless the policy says otherwise" do
    key = Nkey.generate(:user)
    header = Signature.sign(key, @subject, @body, @time)
    stranger = policy(%{})
    assert {:deny, :signature, text} = Sources.identify(stranger, header, @subject, @body, @now)
    assert text == "the key #{key.public} is not one of policy.sources"

    assert {:deny, :signature, "the command is not signed" <> _} =
             Sources.identify(stranger, nil, @subject, @body, @now)

    until = fn day -> policy(%{sources: [%{name: "olga", nkey: key.public, expires: day}]}) end

    assert {:deny, :signature, "the key of olga was good until 2026-11-21"} =
             Sources.identify(until.("2026-11-21"), header, @subject, @body, @now)

    assert {:ok, %{role: :operator}} = Sources.identify(until.("2026-11-22"), header, @subject, @body, @now)

    open = policy(%{unsigned: :viewer})

    assert {:ok, %{name: "unsigned", role: :viewer, permissions: []}} =
             Sources.identify(open, nil, @subject, @body, @now)

    # A wrong signature is not an unsigned command.
    assert {:deny, :signature, _reason} = Sources.identify(open, header <> "x", @subject, @body, @now)
  end

  test "sources that cannot be are refused with their key" do
    key = Nkey.generate(:user).public

    assert Policy.compile(%{
             sources: [
               %{name: "a", nkey: "nonsense"},
               %{name: "b", nkey: Nkey.generate(:account).public},
               %{name: "c", nkey: key, expires: "tomorrow"}
             ]
           })
           |> elem(1)
           |> Enum.map(&String.replace(&1, ~r/got: A\w+/, "got: A")) == [
             "policy.sources[0].nkey: expected the public nkey of a user (U…), got: nonsense",
             "policy.sources[1].nkey: expected the public nkey of a user (U…), got: A",
             "policy.sources[2].expires: expected a day such as 2027-12-31, got: tomorrow"
           ]

    assert {:error, [one, two]} =
             Policy.compile(%{sources: [%{name: "a", nkey: key}, %{name: "a", nkey: key}]})

    assert one == "policy.sources: expected each name once, got: a twice"
    assert two =~ "expected each nkey once"
  end
end
