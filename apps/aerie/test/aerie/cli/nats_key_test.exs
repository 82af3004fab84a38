defmodule Aerie.CLI.NatsKeyTest do
  use ExUnit.Case, async: true

  alias Aerie.Config

  @moduletag :tmp_dir

  defp key(words, dir), do: Aerie.CLI.call(["nats-key" | words], dir)

  test "a key for its owner only, and the section that lists it; again it is the same", %{tmp_dir: dir} do
    assert {0, section} = key(["ops.nk"], dir)
    config = Path.join(dir, "gateway.yaml")
    File.write!(config, section)
    file = Path.join(dir, "ops.nk")
    assert Bitwise.band(File.stat!(file).mode, 0o777) == 0o600
    {:ok, %{public: public}} = file |> File.read!() |> Nkey.from_seed()

    assert {:ok, %{policy: %{sources: [%{name: "ops", nkey: ^public, role: :operator}]}}} =
             Config.load(config, [], env: %{})

    assert key(["ops.nk"], dir) == {0, section}
    assert {0, other} = key(~w(ops.nk --name tower --role viewer), dir)
    assert IO.iodata_to_binary(other) =~ "{name: tower, nkey: #{public}, role: viewer}"
  end

  test "what cannot be is said, and a file that is there stays as it is", %{tmp_dir: dir} do
    File.write!(Path.join(dir, "notes"), "do not lose me")
    File.write!(Path.join(dir, "account.nk"), Nkey.seed(Nkey.generate(:account)))
    File.write!(Path.join(dir, "huge"), String.duplicate("S", 2_000))

    for {words, said} <- [
          {[], "FILE is missing"},
          {["notes"], "is there, and is not the seed of a user's nkey"},
          {["account.nk"], "is not the seed of a user's nkey"},
          {["huge"], "is not the seed of a user's nkey"},
          {["/dev/zero"], "is not the seed of a user's nkey"},
          {["."], "give one with --name"},
          {["missing/ops.nk"], "cannot write"},
          {["two words.nk"], "give one with --name"},
          {~w(a.nk --role king), "--role king: expected one of viewer, operator, pilot, admin"}
        ] do
      assert {:error, text} = key(words, dir), inspect(words)
      assert text =~ said, inspect({words, text})
    end

    assert Enum.sort(File.ls!(dir)) == ["account.nk", "huge", "notes"]
    assert File.read!(Path.join(dir, "notes")) == "do not lose me"
  end
end
