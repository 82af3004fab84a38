defmodule Aerie.SigningCase do
  @moduledoc "Tests of signed links: a gateway's parts with keys, and another end that signs."
  use ExUnit.CaseTemplate

  alias MavCodec.{Frame, Parser}

  @passphrase "gateway-capture-signing-key"
  @captures Path.expand("../../../mav_codec/test/fixtures/captures", __DIR__)

  using do
    quote do
      import Aerie.LinkCase
      import Aerie.SigningCase
    end
  end

  @doc "The passphrase of the recorded link."
  @spec passphrase() :: String.t()
  def passphrase, do: @passphrase

  @doc "A key file that only its owner can read."
  @spec key_file(Path.t(), String.t()) :: Path.t()
  def key_file(dir, text \\ @passphrase) do
    path = Path.join(dir, "key-#{System.unique_integer([:positive])}")
    File.write!(path, text)
    File.chmod!(path, 0o600)
    path
  end

  @doc "Starts the parts of a gateway with one key for network main; gives its name. `options`: `:policy`, `:system_id`, …"
  @spec start_signing(Path.t(), keyword, (map, keyword -> reference)) :: reference
  def start_signing(dir, options \\ [], start \\ &Aerie.LinkCase.start_parts/2) do
    {clock, options} = Keyword.pop(options, :clock)
    key = Map.merge(%{network: "main", key_file: key_file(dir)}, Map.new(options))
    config = %{signing: %{keys: [key], dir: Path.join(dir, "signing")}}
    start.(config, before: [{MavRouter.Signing.Supervisor, clock: clock}])
  end

  @doc "The frames of a recording of mav_codec's fixtures, all at one time."
  @spec captured(String.t(), integer | nil) :: [Frame.t()]
  def captured(name, at \\ nil) do
    bytes = @captures |> Path.join(name <> ".bin.gz") |> File.read!() |> :zlib.gunzip()
    {frames, parser} = Parser.push(Parser.new(), bytes, at)
    {last, _parser} = Parser.flush(parser)
    frames ++ last
  end

  @doc "Everything that Elixir and Erlang write of a term."
  @spec shown(term) :: String.t()
  def shown(term) do
    inspect(term, limit: :infinity, printable_limit: :infinity, structs: false) <>
      inspect(term, limit: :infinity) <> IO.iodata_to_binary(:io_lib.format(~c"~p ~w", [term, term]))
  end

  @doc "Fails if a text has a key, in any of the forms in which Elixir and Erlang write bytes."
  @spec refute_key(String.t(), binary) :: :ok
  def refute_key(text, key) do
    bytes = :binary.bin_to_list(key)
    hex = for letters <- [:upper, :lower], do: Base.encode16(key, case: letters)
    lists = for comma <- [", ", ","], do: bytes |> Enum.take(6) |> Enum.join(comma)

    for form <- [key, Base.encode64(key)] ++ hex ++ lists,
        text =~ form,
        do: ExUnit.Assertions.flunk("a key is shown as #{form}")

    :ok
  end

  @doc "The folder of a running gateway's keys and time stamps as a kill leaves it; a file that is being written is none."
  @spec copy_dir(Path.t(), Path.t()) :: :ok
  def copy_dir(from, to) do
    for file <- Path.wildcard(Path.join(from, "**"), match_dot: true),
        File.regular?(file) and Path.extname(file) != ".new" do
      copy = Path.join(to, Path.relative_to(file, from))
      File.mkdir_p!(Path.dirname(copy))
      File.cp!(file, copy)
    end

    :ok
  end

  @doc "The frame of bytes."
  @spec frame(binary, integer | nil) :: Frame.t()
  def frame(bytes, at \\ nil) do
    {[frame], _parser} = Parser.push_datagram(Parser.new(), bytes, at)
    frame
  end

  @doc "Another end that signs with a passphrase."
  @spec signer(String.t(), keyword) :: MavCodec.Signing.t()
  def signer(passphrase \\ @passphrase, options \\ []),
    do: MavCodec.Signing.new(MavCodec.Signing.key(passphrase), options)

  @doc "Signed bytes of a heartbeat."
  @spec signed(MavCodec.Signing.t(), non_neg_integer, keyword) :: {binary, MavCodec.Signing.t()}
  def signed(signer, system, options \\ []) do
    MavCodec.Signing.sign(signer, Aerie.LinkCase.heartbeat(system, options), 50)
  end

  @doc "A source as links give it."
  @spec source(keyword) :: map
  def source(options \\ []),
    do: Map.merge(%{id: "radio", network: "main", peer: :remote, trust: :radio}, Map.new(options))
end
