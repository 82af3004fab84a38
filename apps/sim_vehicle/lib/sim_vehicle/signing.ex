defmodule SimVehicle.Signing do
  @moduledoc """
  Signed links as ArduPilot has them: it takes SETUP_SIGNING from whoever may speak to it, from then on signs everything and
  asks for signatures, RADIO_STATUS excepted; a key and a time stamp of zeros end that. On a link that counts as USB it
  hears unsigned and wrongly signed frames too. The key survives a reboot.
  """

  alias MavCodec.Frame
  alias MavCodec.Messages.SetupSigning

  @enforce_keys [:secure]
  defstruct [:secure, :state]

  @type t :: %__MODULE__{secure: boolean, state: MavCodec.Signing.t() | nil}

  @doc "With a key from the start, or none; `secure` as USB is."
  @spec new(binary | nil, boolean) :: t
  def new(nil, secure), do: %__MODULE__{secure: secure}
  def new(key, secure), do: %__MODULE__{secure: secure, state: MavCodec.Signing.new(key)}

  @doc "The frame of a message as it goes out."
  @spec sign(t, binary, struct, module) :: {binary, t}
  def sign(%{state: nil} = signing, bytes, _message, _dialect), do: {bytes, signing}
  def sign(signing, <<0xFE, _::binary>> = bytes, _message, _dialect), do: {bytes, signing}

  def sign(signing, bytes, %module{}, dialect) do
    {_id, extra, _base, _extended} = dialect.layout(module)
    {bytes, state} = MavCodec.Signing.sign(signing.state, bytes, extra)
    {bytes, %{signing | state: state}}
  end

  @doc "Whether a frame is heard."
  @spec check(t, Frame.t()) :: {:ok | :refused, t}
  def check(%{state: nil} = signing, _frame), do: {:ok, signing}

  def check(signing, frame) do
    case MavCodec.Signing.check(signing.state, frame) do
      {{:rejected, _why}, state} -> {if(signing.secure, do: :ok, else: :refused), %{signing | state: state}}
      {_right, state} -> {:ok, %{signing | state: state}}
    end
  end

  @doc "SETUP_SIGNING came, for whomever."
  @spec setup(t, SetupSigning.t(), %{system: 0..255, component: 0..255}) :: t
  def setup(signing, %{target_system: system} = setup, %{system: system}) do
    case setup do
      %{secret_key: <<0::256>>, initial_timestamp: 0} -> %{signing | state: nil}
      %{secret_key: key, initial_timestamp: at} -> %{signing | state: MavCodec.Signing.new(key, stored: at)}
    end
  end

  def setup(signing, _for_another, _vehicle), do: signing
end
