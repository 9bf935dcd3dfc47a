//! What a unit says about itself: its names (function code 43), and whether it sends a number back (08). Both are asked
//! last of all: some servers take a request that they do not know for the beginning of another one, and are deaf then.

use std::time::Duration;

use super::super::link::LinkError;
use super::client::RawClient;

/// Silence after which a server that took an unknown request for the start of another one listens again (libmodbus:
/// one second).
const RECOVERY: Duration = Duration::from_millis(1200);

impl RawClient {
    /// Vendor, product and revision as the unit gives them; empty where it does not.
    ///
    /// # Errors
    /// [`LinkError::Gone`] only: a unit that has no names is no fault.
    pub fn names(&mut self) -> Result<Vec<String>, LinkError> {
        // Read device identification, basic objects, from the first.
        let objects = self.optional(&[43, 14, 1, 0], "the device identification")?;
        Ok(objects.map_or_else(Vec::new, |pdu| object_texts(&pdu)))
    }

    /// One object of the identification; `None` where the unit does not have it.
    ///
    /// # Errors
    /// [`LinkError::Gone`] only.
    pub fn object(&mut self, object: u8) -> Result<Option<String>, LinkError> {
        let objects = self.optional(&[43, 14, 4, object], "an object of the identification")?;
        Ok(objects.and_then(|pdu| object_texts(&pdu).into_iter().next()))
    }

    /// Whether the unit sends a number back; `None` where it has never answered anything.
    ///
    /// # Errors
    /// [`LinkError::Gone`] only.
    pub fn sends_back(&mut self) -> Result<Option<bool>, LinkError> {
        if !self.is_heard() {
            return Ok(None);
        }
        let echo = self.optional(&[8, 0, 0, 0x5A, 0xC3], "the diagnostic echo")?;
        Ok(Some(echo.is_some()))
    }

    /// The answer to a question that not every unit knows.
    fn optional(&mut self, pdu: &[u8], what: &str) -> Result<Option<Vec<u8>>, LinkError> {
        if !self.is_heard() {
            return Ok(None);
        }
        match self.ask(pdu, what) {
            Ok(answer) => Ok(Some(answer.to_vec())),
            Err(error @ LinkError::Gone { .. }) => Err(error),
            Err(LinkError::Exception { .. }) => Ok(None),
            Err(_) => {
                std::thread::sleep(RECOVERY);
                Ok(None)
            }
        }
    }
}

/// The texts of the objects of a device identification; what does not fit its own lengths ends the list.
fn object_texts(pdu: &[u8]) -> Vec<String> {
    let mut rest = pdu.get(7..).unwrap_or_default();
    let mut texts = Vec::new();
    while let [_, length, tail @ ..] = rest
        && let Some((text, after)) = tail.split_at_checked(usize::from(*length))
    {
        texts.push(String::from_utf8_lossy(text).into_owned());
        rest = after;
    }
    texts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_taken_as_far_as_they_fit() {
        let pdu = [&[43, 14, 1, 1, 0, 0, 2, 0, 2][..], b"Ab", &[1, 1], b"C"].concat();
        assert_eq!(object_texts(&pdu), ["Ab", "C"]);
        assert_eq!(object_texts(&pdu[..10]), [""; 0]);
        assert_eq!(object_texts(&[]), [""; 0]);
    }
}
