defmodule Aerie.Access.HTTP.AdmissionTest do
  use ExUnit.Case, async: true

  alias Aerie.Access.{Keys, Principals}
  alias Aerie.Base.Secret
  alias Aerie.Access.HTTP.Admission

  @local %{peer: {127, 0, 0, 1}, forwarded: false, host: "127.0.0.1:4000", origin: nil, key: nil}
  @open %{keys: [], origins: [], ports: [], hosts: []}

  defp keyed do
    {:ok, keys} = Keys.load(%{key: Secret.new("the-right-key-of-all"), keys_file: nil})
    %{@open | keys: keys}
  end

  defp decide(policy, changes), do: Admission.decide(policy, Map.merge(@local, changes))
  defp name({:ok, requester}), do: requester.name
  defp code({:error, error}), do: error.code

  describe "without a key" do
    test "this machine has access, by any of its names" do
      for host <- [nil, "localhost", "LOCALHOST:4000", "127.0.0.1", "127.1.2.3:80", "[::1]:4000", "[::1]"],
          do: assert(decide(@open, %{host: host}) |> name() == "local")

      assert decide(@open, %{peer: {0, 0, 0, 0, 0, 0, 0, 1}}) |> name() == "local"
    end

    test "nobody else has access, nor a proxy for somebody else" do
      assert code(decide(@open, %{peer: {10, 0, 0, 2}})) == :forbidden
      assert code(decide(@open, %{forwarded: true})) == :forbidden
    end

    test "a foreign name that points here is refused (DNS rebinding)" do
      for host <- [
            "evil.example",
            "evil.example:4000",
            "127.0.0.1.evil.example",
            "localhost.evil.example",
            "10.0.0.1",
            "",
            "[",
            "::::"
          ],
          do: assert(code(decide(@open, %{host: host})) == :forbidden)
    end
  end

  describe "with a key" do
    test "the key gives access, from anywhere and by any name" do
      assert {:ok, %{kind: :key, name: "api.key", role: nil}} =
               decide(keyed(), %{peer: {10, 0, 0, 2}, host: "gw.example", key: "the-right-key-of-all"})
    end

    test "nothing else does, not even being this machine" do
      assert code(decide(keyed(), %{})) == :unauthorized
      assert code(decide(keyed(), %{key: "the-right-key-of-al"})) == :unauthorized
      assert code(decide(keyed(), %{key: ""})) == :unauthorized
    end
  end

  describe "a change of the gateway" do
    test "needs a role: a key's own, an admin's of a key without one, an operator's at most without a key" do
      {:ok, program} = decide(@open, %{})
      {:ok, bare} = decide(keyed(), %{key: "the-right-key-of-all"})
      viewer = Principals.of(%{name: "wall", digest: "", role: :viewer, permissions: [], until: nil})
      pilot = Principals.of(%{name: "pia", digest: "", role: :pilot, permissions: [], until: nil})
      for least <- [:viewer, :operator, :admin], do: assert(Admission.may(bare, least) == :ok)
      assert Admission.may(program, :operator) == :ok
      assert Admission.may(viewer, :viewer) == :ok

      for {who, least, words} <- [
            {program, :admin, "while no key is configured programs of this machine are operators at most"},
            {viewer, :operator, "the key wall may only read (role=viewer)"},
            {pilot, :admin, "the key pia has the role pilot; this needs admin"}
          ] do
        assert {:error, %{code: :forbidden, message: message}} = Admission.may(who, least)
        assert message =~ words
      end
    end
  end

  describe "what needs no key" do
    test "is answered for a host name of the gateway, an address, or with a key" do
      {:ok, own} = :inet.gethostname()
      host = fn policy, changes -> Admission.host(policy, Map.merge(@local, changes)) end
      named = %{keyed() | hosts: ["gw.example"]}

      for name <- [nil, "localhost:4000", "#{own}.local", "GW.example:80", "192.0.2.7", "[2001:db8::7]:4000"],
          do: assert(host.(named, %{host: name}) == :ok)

      assert {:error, %{code: :forbidden}} = host.(named, %{host: "evil.example"})

      assert {:error, %{code: :forbidden}} =
               host.(named, %{host: "evil.example", key: "another-key-than-that"})

      assert host.(named, %{host: "evil.example", key: "the-right-key-of-all"}) == :ok
    end
  end

  describe "a web page" do
    test "of the gateway itself or of a configured origin may" do
      assert {:ok, _name} = decide(@open, %{origin: "http://127.0.0.1:4000"})
      console = %{@open | ports: [4000]}
      assert {:ok, _name} = decide(console, %{host: "127.0.0.1:8765", origin: "http://127.0.0.1:4000"})
      listed = %{keyed() | origins: ["https://gcs.example.org"]}
      facts = %{host: "gw:4000", origin: "https://GCS.example.org", key: "the-right-key-of-all"}
      assert {:ok, _name} = decide(listed, facts)
    end

    test "of anybody else may not, not even with a valid key" do
      for origin <- [
            "https://evil.example",
            "null",
            "",
            "file://",
            "http://127.0.0.1:9999",
            "http://127.0.0.1.evil.example:4000",
            "https://127.0.0.1@evil.example",
            "http://[",
            "http://gcs.example.org"
          ] do
        policy = %{keyed() | origins: ["https://gcs.example.org"], ports: [4000]}
        assert code(decide(policy, %{origin: origin, key: "the-right-key-of-all"})) == :forbidden
      end
    end
  end
end
