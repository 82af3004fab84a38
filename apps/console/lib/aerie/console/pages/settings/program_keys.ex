defmodule Aerie.Console.Pages.Settings.ProgramKeys do
  @moduledoc "The keys of programs: all of them, a form for a new one, and the new one itself, once."
  use Aerie.Console, :component

  alias Aerie.Control.Policy.Roles

  attr :keys, :list, required: true, doc: "`t:Aerie.Access.KeyRing.shown/0`"
  attr :made, :any, required: true, doc: "name and text of the key that was just made, nil for none"
  attr :error, :string, required: true

  @doc "The card."
  def program_keys(assigns) do
    ~H"""
    <section class="card" aria-labelledby="keys-title">
      <h2 id="keys-title">Keys of programs</h2>
      <p :if={@keys == []} class="muted">No keys: only programs on this machine can use <code>/api</code>, and only to read.</p>
      <.data_table :if={@keys != []} id="keys" label="Keys" rows={Enum.with_index(@keys)} row_id={fn {_key, index} -> "key-#{index}" end}>
        <:col :let={{key, _index}} label="Name"><strong>{key.name}</strong></:col>
        <:col :let={{key, _index}} label="Role">{key.role || "everything"}</:col>
        <:col :let={{key, _index}} label="Permissions">{Enum.join(key.permissions, ", ")}</:col>
        <:col :let={{key, _index}} label="Expires">{until(key.until)}</:col>
        <:col :let={{key, _index}} label="">
          <.button :if={key.made} small icon="trash" phx-click="ask" phx-value-what="revoke" phx-value-name={key.name}>Revoke</.button>
          <span :if={not key.made} class="muted">configured</span>
        </:col>
      </.data_table>
      <div :if={@made} id="new-key" class="notice info" role="status">
        <div>
          <p>The key of <strong>{elem(@made, 0)}</strong>. It is shown only once; copy it now:</p>
          <p><code id="new-key-text" class="mono">{elem(@made, 1)}</code></p>
          <.button small phx-click="key-copied">Done</.button>
        </div>
      </div>
      <h3>New key</h3>
      <form id="add-key" class="form-row" phx-submit="add-key" phx-auto-recover="ignore" autocomplete="off">
        <.field id="key-name" name="name" label="Name of the program" maxlength="32" required />
        <.field id="key-role" name="role" type="select" label="Role" options={Enum.map(Roles.all(), &to_string/1)} value="viewer" />
        <.field id="key-expires" name="expires" type="date" label="Expires (blank = never)" />
        <.button type="submit" kind="primary" icon="plus">Create key</.button>
      </form>
      <p :if={@error} class="notice bad" role="alert">{@error}</p>
      <p class="hint">
        <span :if={@keys == []}>Once there is a key, programs on this machine need one too.</span>
        You can also configure keys with <code>api.key</code> and <code>api.keys_file</code>.
      </p>
    </section>
    """
  end

  defp until(nil), do: "–"

  defp until(us),
    do: us |> DateTime.from_unix!(:microsecond) |> DateTime.add(-1) |> DateTime.to_date() |> Date.to_iso8601()
end
