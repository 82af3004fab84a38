defmodule NkeyTest do
  use ExUnit.Case, async: true

  alias Nkey.Credentials

  # The example of the NATS documentation on nkeys: a seed and the public key that belongs to it.
  @seed "SUACSSL3UAHUDXKFSNVUZRF5UHPMWZ6BFDTJ7M6USDXIEDNPPQYYYCU3VY"
  @public "UDXU4RCSJNZOIQHZNWXHXORDPRTGNJAHAHFRGZNEEJCPQTT2M7NLCNF4"

  test "a seed gives the public key that the server knows it by" do
    assert {:ok, %Nkey{purpose: :user, public: @public} = nkey} = Nkey.from_seed(@seed)
    assert Nkey.seed(nkey) == @seed
    assert {:ok, ^nkey} = Nkey.from_seed("\n  #{@seed} \n")
  end

  test "every purpose has its letter, and comes back from its seed" do
    for {purpose, letter} <- [operator: "O", server: "N", cluster: "C", account: "A", user: "U"] do
      nkey = Nkey.generate(purpose)
      assert String.first(nkey.public) == letter
      assert "S" <> rest = Nkey.seed(nkey)
      assert String.first(rest) == letter
      assert {:ok, ^nkey} = Nkey.from_seed(Nkey.seed(nkey))
    end
  end

  test "a signature is Ed25519 of the bytes" do
    {:ok, nkey} = Nkey.from_seed(@seed)
    {public, _} = :crypto.generate_key(:eddsa, :ed25519, nkey.secret)
    signature = Nkey.sign(nkey, "nonce")
    assert byte_size(signature) == 64
    assert :crypto.verify(:eddsa, :none, "nonce", signature, [public, :ed25519])
  end

  test "the secret is not inspected" do
    {:ok, nkey} = Nkey.from_seed(@seed)
    refute inspect(nkey) =~ "secret"
  end

  test "an invalid seed is an error that says why, without showing it" do
    wrong = String.replace_suffix(@seed, "VY", "VA")

    for {seed, why} <- [
          {"", "right length"},
          {"not base 32!", "base 32"},
          {wrong, "checksum"},
          {@public, "does not begin with S"},
          {String.slice(@seed, 0, 20), "checksum"},
          {nil, "beginning with S"}
        ] do
      assert {:error, text} = Nkey.from_seed(seed)
      assert text =~ why
      if is_binary(seed) and seed != "", do: refute(text =~ seed)
    end
  end

  test "the public half verifies what the secret half signed" do
    assert {:ok, :user, public} = Nkey.from_public(@public)
    {:ok, key} = Nkey.from_seed(@seed)
    signature = Nkey.sign(key, "some bytes")
    assert Nkey.verify(public, "some bytes", signature)
    refute Nkey.verify(public, "other bytes", signature)
    refute Nkey.verify(public, "some bytes", "short")
    refute Nkey.verify(public, "some bytes", :binary.copy(<<1>>, 64))

    for text <- [@seed, "", "U", String.replace(@public, "X", "Y"), String.slice(@public, 0, 50), nil],
        do: assert({:error, "" <> _} = Nkey.from_public(text))
  end

  test "no text raises" do
    property =
      :proper.forall(:proper_types.binary(), fn text ->
        match?({:error, _}, Nkey.from_seed(text)) and match?({:error, _}, Nkey.from_public(text))
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 200]) == true, inspect(:proper.counterexample())
  end

  describe "credentials" do
    test "are the JWT and the seed of a file" do
      text = creds("abc.def-g.h_i", @seed)
      assert {:ok, %{jwt: "abc.def-g.h_i", nkey_seed: @seed}} = Credentials.parse(text)
      assert {:ok, %{jwt: "abc.def-g.h_i"}} = text |> String.replace("\n", "\r\n") |> Credentials.parse()
    end

    test "without a part, or with an invalid one, say so" do
      assert {:error, "no NATS USER JWT block"} = Credentials.parse("")
      [jwt_only, _] = String.split(creds("abc", @seed), "-----BEGIN USER")
      assert {:error, "no USER NKEY SEED block"} = Credentials.parse(jwt_only)
      assert {:error, text} = Credentials.parse(creds("abc", "SUABC"))
      assert text =~ "not an nkey seed"
    end

    @tag :tmp_dir
    test "of a file name the file", %{tmp_dir: dir} do
      path = Path.join(dir, "a.creds")
      assert {:error, error} = Credentials.read(path)
      assert error =~ "a.creds: no such file"
      File.write!(path, "nonsense")
      assert {:error, error} = Credentials.read(path)
      assert error =~ "a.creds: no NATS USER JWT block"
      File.write!(path, :binary.copy("x", 1_048_577))
      assert {:error, error} = Credentials.read(path)
      assert error =~ "too many"
    end
  end

  defp creds(jwt, seed) do
    """
    -----BEGIN NATS USER JWT-----
    #{jwt}
    ------END NATS USER JWT------

    ************************* IMPORTANT *************************
    NKEY Seed printed below can be used to sign and prove identity.

    -----BEGIN USER NKEY SEED-----
    #{seed}
    ------END USER NKEY SEED------
    """
  end
end
